"""Reports: opened in Chromium, their tables held against the run's JSON; and runs side by side."""

import dataclasses
import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image
from plotly.offline import get_plotlyjs_version

from tests.drawing import draws_with
from tests.durations import cpu_seconds
from tests.looking import browser
from tests.test_cli import refused, told
from tests.test_view import not_blank
from tulip_testbed import rendering
from tulip_testbed.base.table import Table
from tulip_testbed.cli.main import main
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.pages import pictures
from tulip_testbed.pages.page import html
from tulip_testbed.pages.run_page import validation_page

MOST_SECONDS = 20
MOST_BYTES = {"run_folder": 2e6, "discovered_folder": 12e6}


def reported(request, name, path):
    """Write the page of the folder that is a fixture, soon and small."""
    began = cpu_seconds()
    assert main(["report", str(request.getfixturevalue(name)), "--out", str(path)]) == 0
    assert cpu_seconds() - began < MOST_SECONDS
    assert path.stat().st_size < MOST_BYTES[name]
    return path


@pytest.fixture(scope="module")
def page(request, tmp_path_factory):
    return reported(request, "run_folder", tmp_path_factory.mktemp("report") / "run.html")


@draws_with("chromium")
@pytest.mark.parametrize("name", ["run_folder", pytest.param("discovered_folder", marks=pytest.mark.slow)])
def test_a_browser_has_nothing_to_complain_of(name, request, tmp_path):
    """Wide and light, narrow and dark."""
    page = reported(request, name, tmp_path / "page.html")
    with browser() as visit:
        for width, dark in ((1100, False), (412, True)):
            observed = visit(page, tmp_path / "page.png", (width, 900), dark)
            assert observed.complaints == []
            assert observed.requests == []
            assert observed.width == width
            not_blank(tmp_path / "page.png")
            brightness = np.asarray(Image.open(tmp_path / "page.png").convert("L"))[:200].mean()
            assert (brightness < 100) == dark


def test_the_page_has_the_plotly_of_the_package(page):
    assert f"plotly.js (cartesian - minified) v{get_plotlyjs_version()}\n" in page.read_text(encoding="utf-8")


def test_the_page_has_the_tables_of_the_run(page, run_folder, robot):
    text = page.read_text(encoding="utf-8")
    tables = [part for part in Validation.load(run_folder, robot).tables() if isinstance(part, Table)]
    assert len(tables) == 4
    assert all(table.html() in text for table in tables)


def test_every_picture_has_words(page):
    text = page.read_text(encoding="utf-8")
    images = re.findall(r"<img [^>]*>", text)
    assert all(re.search(r'alt="[^"]{20,}"', image) for image in images)
    figures = re.findall(r'<div id="[\w-]+" role="img"[^>]*>', text)
    assert len(figures) >= 9
    assert all(re.search(r'aria-label="[^"]{20,}"', place) for place in figures)
    assert "http://" not in re.sub(r"<script>.*?</script>", "", text, flags=re.S)


def test_without_opengl_the_report_says_what_to_install(run_folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(pictures, "rendered", rendering.rendered)
    monkeypatch.setattr(rendering, "PLATFORMS", ("nothing",))
    assert main(["report", str(run_folder), "--out", str(tmp_path / "x.html")]) == 0
    packages = "apt-get install libegl1 libgl1-mesa-dri libosmesa6"
    assert packages in " ".join(capsys.readouterr().out.split())
    assert packages in (tmp_path / "x.html").read_text(encoding="utf-8")


def test_a_failed_verdict_names_the_checks_and_a_hostile_name_stays_text(run_folder, robot):
    saved = Validation.load(run_folder, robot)
    name = "</script><script>alert(1)</script>"
    first, *others = saved.checks
    checks = (dataclasses.replace(first, result="fail", name=name), *others)
    found = validation_page(dataclasses.replace(saved, checks=checks))
    assert found.sentence.startswith("Is it right? no, 1 of ")
    assert name in found.sentence
    assert "<script>alert(1)" not in html(found)


def test_an_unfinished_montecarlo_is_not_reported(coverage, tmp_path, capsys):
    shutil.copytree(coverage, tmp_path / "part")
    (tmp_path / "part" / "runs" / "chunk-000001.parquet").unlink()
    message = refused(capsys, "report", tmp_path / "part", "--out", tmp_path / "x.html")
    assert "holds 25 of 40 runs" in message


def test_two_runs_side_by_side(run_folder, coverage, ideal, tmp_path, capsys):
    ideal.save(tmp_path / "ideal")
    document = told(capsys, "report", run_folder, tmp_path / "ideal")
    assert document["settings"]["configuration.preset"] == ["wii", "ideal"]
    assert document["settings"]["configuration.seed"] == [102, 101]
    assert not any(name.startswith("outputs") for name in document["settings"])
    row = document["models"]["full"][9]
    reports = [json.loads((f / "result.json").read_text()) for f in (run_folder, tmp_path / "ideal")]
    assert row["estimate"] == [report["identification"]["full"]["value"][9] for report in reports]
    assert main(["report", str(coverage), str(coverage)]) == 0
    capsys.readouterr()
    message = refused(capsys, "report", run_folder, coverage)
    assert "found a validation and a Monte Carlo, expected two of a kind" in message

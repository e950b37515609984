"""A discovery's view, page and comparison: opened in rerun and Chromium, held against its JSON."""

import dataclasses
import re
import shutil
from html import unescape

import numpy as np
import pytest

import tulip_testbed as tt
from tests.drawing import draws_with
from tests.durations import cpu_seconds
from tests.first_look import cases
from tests.test_cli import told
from tests.test_records import put_right
from tests.test_refusals import refuse, rows
from tests.test_view import look, not_blank
from tulip_testbed.cli.main import main
from tulip_testbed.discovery.experiment_information import Explanation
from tulip_testbed.discovery.next_experiment import ExpectedResult, NextExperiment
from tulip_testbed.discovery.patterns import Pattern
from tulip_testbed.experiments.discovery_curves import residual_curves
from tulip_testbed.pages.discovery_figures import evidence_figure
from tulip_testbed.pages.discovery_page import discovery_page
from tulip_testbed.pages.page import html
from tulip_testbed.viewer import window
from tulip_testbed.viewer.discovery_view import discovery_text, log_discovery

ADOPTED = ("named", "described", "calibrated")
MOST_SECONDS, MOST_VIEW = 20, 60e6


@pytest.fixture(scope="module")
def saved(discovered_folder, robot):
    return tt.Discovered.load(discovered_folder, robot)


def test_what_is_left_is_noise_and_what_was_there_is_not(saved):
    """The band that is drawn is the noise: residuals over it have a mean square near one."""
    curves = residual_curves(saved)
    for curve in curves:
        there = np.isfinite(curve.sd)
        after = (curve.after / curve.sd)[there]
        # Known up to the mean of a stance of four postures or so, x, y and yaw scatter less.
        assert 0.6 < np.sqrt(np.mean(after**2)) < 1.2, curve.name
    ratio = {curve.name: np.nanmean((curve.before / curve.sd) ** 2) for curve in curves}
    assert ratio["swing foot's pitch"] > 100
    assert ratio["sum of the vertical forces"] < 1.4


@pytest.mark.slow
@draws_with("vulkan")
def test_rerun_draws_every_view(discovered_folder, saved, tmp_path):
    began = cpu_seconds()
    assert main(["view", str(discovered_folder), "--save", str(tmp_path / "d.rrd")]) == 0
    assert cpu_seconds() - began < MOST_SECONDS
    assert (tmp_path / "d.rrd").stat().st_size < MOST_VIEW
    observed = look(tmp_path / "d.rrd", {"posture": 40}, tmp_path / "d.png")
    assert len(observed) == 10
    assert sum(name.startswith("Before") for name in observed) == 2
    assert sum(name.startswith("After") for name in observed) == 2
    assert not any(observed.values()), observed
    not_blank(tmp_path / "d.png")


def other(saved, verdict, robot):
    """The same discovery with another verdict."""
    changes = {"verdict": verdict}
    (best,) = saved.explanations
    if verdict == "none":
        changes |= {"explanations": (), "calibrated": (), "families": ()}
    if verdict == "calibrated":
        changes |= {"explanations": ()}
    if verdict != "named":
        changes |= {"adopted": (), "after": None}
    if verdict not in ADOPTED:
        changes |= {"rig_files": {}}
    if verdict == "ambiguous":
        length = tt.EffectInstance.parse("link-length:right_lower_leg=0.004", robot)
        rival = Explanation(length, best.log_bayes_factor - 1.5)
        predicted = ExpectedResult("link-length:right_lower_leg", 0.1, 0.1, 0.1, 0.1, 0.1)
        numbers = (6, 30, 42.0, 0.6, 0.1, 0.012, 20.0, 1.5)
        turned = NextExperiment("one", ("robot turned by 180 deg",), *numbers, (predicted,), tt.plans.random)
        changes |= {"explanations": (best, rival), "next_experiments": (turned,)}
    if verdict == "unknown":
        changes |= {"patterns": (Pattern("C", "the foot's height", 50.0, 1, 1e-9, 0.6),), "check": None}
    if verdict == "described":
        texts = ("own-angle/linear=0.01,-0.2,1.8", "leg-load/linear=0.01,100,250")
        law, rival = (tt.EffectInstance.parse(f"law:encoder:right_knee/{text}", robot) for text in texts)
        also = (Explanation(law, 10.0), Explanation(rival, 9.0))
        changes |= {"adopted": (law,), "after": saved.after, "explanations": also}
    return dataclasses.replace(saved, **changes)


@cases("verdict", ["named", "described", "ambiguous", "unknown"], ["none", "calibrated"])
def test_every_verdict_has_its_page_and_its_view(saved, verdict, robot, tmp_path):
    run = other(saved, verdict, robot)
    page = discovery_page(run)
    titles = {section.title for section in page.sections}
    assert page.verdict == verdict
    assert ("Evidence" in titles) == (verdict not in ("none", "calibrated"))
    assert ("Ordinary imperfections" in titles) == (verdict != "none")
    assert ("The law" in titles) == (verdict == "described")
    assert ("Next experiment" in titles) == (verdict == "ambiguous")
    assert ("The adopted rig" in titles) == (verdict in ADOPTED)
    names = {figure.name for section in page.sections for figure in section.figures}
    assert ("plane-after" in names) == (verdict != "none")
    assert ("law-0" in names) == (verdict == "described")
    text = html(page)
    assert f'class="verdict {verdict}"' in text
    told = unescape(re.sub("</?code>", "`", text))
    assert all(line in told for line in run.story)
    if verdict == "described":
        assert "9.0, 27 %" in evidence_figure(run.explanations, ()).text  # exp(9) / (exp(9) + exp(10))
    if verdict == "ambiguous":
        assert "link-length:right_lower_leg" in "\n".join(discovery_text(run, 1))
        assert "1.5" in text
    window.save(tmp_path / "v.rrd", "v", lambda recording: log_discovery(recording, run))


def test_two_discoveries_side_by_side(discovered_folder, saved, tmp_path, capsys):
    document = told(capsys, "report", discovered_folder, discovered_folder)
    assert document["verdict"] == ["named", "named"]
    values = {check["name"]: check["value"] for check in document["checks"]}
    assert values["gap C, before"] == [saved.heldout.before["C"]] * 2
    assert len(document["models"]["full"]) == 25
    assert main(["report", str(discovered_folder), str(discovered_folder)]) == 0
    assert "Gap and evidence" in capsys.readouterr().out


@rows("residuals")
def test_residuals_that_do_not_fit_are_refused(discovered_folder, robot, tmp_path, changes, words):
    """With matching hashes, as another program might write them."""
    work = shutil.copytree(discovered_folder, tmp_path / "work")
    path = work / "residuals.csv"
    path.write_text(eval(changes[0], {"text": path.read_text()}))
    put_right(work, path.name)
    refuse(words, tt.Discovered.load, work, robot)


def test_a_discovery_of_some_rows_of_a_motion_is_read_again(discovered, robot, tmp_path):
    """Its residuals are those of rows between which the noise has changed."""
    m, still = discovered.measurements, 0 * discovered.measurements.joint_angles
    numbers = np.arange(1, len(m) + 1)
    moving = dataclasses.replace(m, posture=numbers, joint_rates=still, joint_accelerations=still)
    some = {name: values[::3] for name, values in (discovered.residuals | {"posture": numbers}).items()}
    dataclasses.replace(discovered, measurements=moving, residuals=some).save(tmp_path / "moved")
    saved = tt.Discovered.load(tmp_path / "moved", robot)
    np.testing.assert_array_equal(saved.searched.time, m.time[::3])
    assert residual_curves(saved)[0].before == pytest.approx(residual_curves(discovered)[0].before[::3])
    assert discovery_page(saved)
    window.save(tmp_path / "v.rrd", "v", lambda recording: log_discovery(recording, saved))

"""Results as a researcher meets them: parameters by name, tables that print themselves, data frames."""

import dataclasses
import shutil
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import t as t_distribution

import tulip_testbed as tt
from tests.test_refusals import change_document, refuse
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.parameter_tables import NOT_AT_REST, parameter_table, read_reported
from tulip_testbed.identification.statistics import high_correlations, standard_errors


@pytest.fixture(scope="module")
def fit(wii):
    return wii.identification


def test_a_parameter_by_name_and_by_number(fit):
    found = fit["torso.y"]
    error = standard_errors(fit.full.covariance)[9]
    assert (found.number, found.name) == (10, "torso.y")
    assert found.value == fit.full.value[9]
    assert found.standard_error == error
    half = t_distribution.ppf(0.975, fit.full.interval_dof[9]) * error
    assert found.interval95 == pytest.approx((found.value - half, found.value + half))
    assert fit[10] == fit[np.int64(10)] == found
    assert repr(found) == f"torso.y (no. 10): {1e3 * found.value:.2f} ± {1e3 * half:.2f} mm (95 %)"


def test_names_are_those_of_the_base_parameters(fit):
    assert list(fit) == fit._ipython_key_completions_() == list(fit.parameters.names)
    assert len(fit) == 25
    assert "torso.x" in fit
    assert [p.number for p in fit.values()] == list(range(1, 26))


@pytest.mark.parametrize("name", ["torso.w", "", 0, 1.5, None, ("a", "b")])
def test_an_unknown_parameter_is_a_key_that_is_not_there(fit, name):
    with pytest.raises(KeyError):
        fit[name]
    assert name not in fit
    assert fit.get(name) is None


def test_both_models_have_a_frame(fit):
    frame = fit.to_frame()
    assert list(frame.index) == list(fit)
    assert frame.loc["torso.y", "estimate [mm]"] == 1e3 * fit["torso.y"].value
    assert frame.loc["torso.y", "s.e. [mm]"] == 1e3 * fit["torso.y"].standard_error
    assert "truth [mm]" not in frame
    assert len(fit.to_frame(model="simplified")) == 13
    assert repr(fit.full).startswith("Estimate: 25 parameters, residual sigma ")


def test_correlations_by_name(fit):
    found = fit.correlations
    pairs = high_correlations(fit.full.covariance, fit.full.numbers, 0.85)
    names = fit.parameters.names
    assert [(p.a, p.b, p.rho) for p in found.above(0.85)] == [
        (names[a - 1], names[b - 1], rho) for a, b, rho in pairs
    ]
    a, b, rho = found.above()[0]
    assert found[a, b] == found[pairs[0][0], pairs[0][1]] == rho
    assert found[b, a] == pytest.approx(rho)
    assert found[a, a] == pytest.approx(1)
    assert f"{a}" in repr(found.above())
    assert f"{rho:+.4f}" in repr(found.above())
    assert f"{rho:+.4f}" in repr(found)
    assert repr(found.above(0.9999)) == "No correlation above 0.9999."
    assert "No correlation" in found.above(0.9999)._repr_html_()
    frame = found.to_frame()
    assert frame.loc[a, b] == rho
    assert frame.shape == (25, 25)
    assert len(found.above().to_frame()) == len(pairs)


def test_an_identification_prints_as_table_ii(fit):
    text = repr(fit).partition("Simplified model")[0]
    for name, value, error in zip(
        fit.full.names, fit.full.value, standard_errors(fit.full.covariance), strict=True
    ):
        (line,) = (
            line
            for line in text.splitlines()
            if f" {name} " in line and "mm" not in line and line.split()[0].isdigit()
        )
        assert line.split()[2:4] == [f"{1e3 * value:.2f}", f"{1e3 * error:.2f}"]
    assert f"Residual norm: mean {1e3 * fit.full.residual_norms.mean():.2f}" in text
    assert f"Total mass {fit.mass[0]:.3f} kg, standard error {fit.mass[1]:.3f} kg." in repr(fit)
    for pair in fit.correlations.above(0.85):
        assert f"{pair.rho:+.4f}" in text
    assert max(map(len, text.splitlines())) <= 100
    page = fit._repr_html_().partition("Simplified model")[0]
    assert page.count("<tr>") == 27 + len(fit.correlations.above(0.85))


def test_an_estimate_that_did_not_come_to_rest_answers_without_parameters(fit):
    assert isinstance(fit.answer()[0], Table)
    unsteady: Any = SimpleNamespace(steady=False)
    lost = dataclasses.replace(fit, calibration=unsteady).answer()
    assert not any(isinstance(one, Table) for one in lost)
    assert NOT_AT_REST in lost


def test_a_validation_as_a_frame(wii):
    frame = wii.to_frame()
    assert frame["truth [mm]"].to_numpy() == pytest.approx(1e3 * wii.truth)
    assert frame["error [mm]"].to_numpy() == pytest.approx(1e3 * (wii.identification.full.value - wii.truth))


def test_the_terminal_and_the_page_have_one_table_of_parameters(wii, robot):
    """Every number of the report's rows, the truth's error and all that the paper says."""
    full, parameters = wii.identification.full, wii.identification.parameters
    table = parameter_table("full", full, parameters, wii.truth, read_reported(robot))
    headings = [column.name for column in table.columns]
    assert headings == [
        *("no.", "parameter", "truth", "estimate", "error", "s.e.", "relative s.e.", "well identified"),
        *("paper's estimate", "paper's relative s.e.", "paper's s.e.", "s.e. over paper's", "links"),
    ]
    assert table.texts[0][8:10] == ["-10.96", "13.0"]
    assert float(table.texts[0][10]) == pytest.approx(10.96 * 0.13, abs=0.006)
    errors = full.standard_error[9], full.relative_standard_error[9]
    own = [10, "torso.y", wii.truth[9], full.value[9], full.value[9] - wii.truth[9], *errors]
    assert [cell.value for cell in table.cells[9][:7]] == own
    assert "4.2, 3.6, 10.7" in table.note


@pytest.mark.parametrize("lines", [0, 1])
def test_a_table_of_the_paper_without_rows_is_refused(lines, robot, tmp_path):
    folder = shutil.copytree(robot.folder, tmp_path / "robot")
    header = (folder / "table2.csv").read_text().splitlines(keepends=True)[:lines]
    (folder / "table2.csv").write_text("".join(header))
    refuse(
        "table2.csv: found no row, expected numbers in the columns number, full_mm,",
        described_robot,
        folder / robot.path.name,
    )


def test_clustered_errors_have_a_column_where_they_differ(wii):
    own = wii.identification
    full = dataclasses.replace(own.full, clustered_covariance=4 * own.full.covariance)
    table = parameter_table("full", full, own.parameters, wii.truth)
    headings = [column.name for column in table.columns]
    assert headings[2:7] == ["truth", "estimate", "error", "s.e.", "clustered s.e."]
    assert float(table.texts[0][6]) == pytest.approx(2e3 * full.standard_error[0], abs=0.006)


def test_an_edited_result_is_refused_when_it_is_read(run, robot, tmp_path):
    tt.identify(run, robot).save(tmp_path / "fit")
    file = tmp_path / "fit" / "result.json"
    intact = file.read_text()
    for change in ('estimator = "x"', "confounded = null", "calibration.covariance = null"):
        file.write_text(intact)
        change_document(file, change)
        with pytest.raises(tt.InputError, match=r"found values that do not fit together|key"):
            tt.Identification.load(tmp_path / "fit", robot)
    refuse("robot: found none, expected it behind the folder", tt.Identification.load, tmp_path / "fit")

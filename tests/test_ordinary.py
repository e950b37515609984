"""Experiments in ordinary laboratories: drawn by a stream of their own, judged against their own truth."""

import dataclasses
import inspect
import json
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tests.test_refusals import refuse
from tulip_testbed.calibration.families import families_of, tolerances_of
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.experiments.checks import correlation_checks, data_correlation_checks
from tulip_testbed.experiments.defaults import DEFAULT_ESTIMATOR, ORDINARY
from tulip_testbed.experiments.imperfections import draw_members, drawn, ordinary_members, single_stream
from tulip_testbed.experiments.montecarlo.laboratory_runs import source_of, stream_of
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo, Settings
from tulip_testbed.experiments.validate import evaluate, judge
from tulip_testbed.identification.observation import observe
from tulip_testbed.measurements import SensorSheet, write_measurements
from tulip_testbed.sim.rig import preset_rig

SEED = 140


@pytest.fixture(scope="module")
def validated(robot, plan):
    return tt.validate(tt.Laboratory(robot, "wii"), plan, seed=SEED, engine="statics")


def test_members_are_drawn_for_all_families(robot):
    families = families_of(robot, tolerances_of(SensorSheet()))
    values, spreads = draw_members(families, np.random.default_rng(1))
    assert (spreads >= 0.1).all()
    assert (spreads <= 1).all()
    many = [draw_members(families, np.random.default_rng(k)) for k in range(400)]
    for j, family in enumerate(families):
        size = np.sqrt(np.mean([(v[j] / s[j]) ** 2 for v, s in many]))
        assert size == pytest.approx(family.tolerance, rel=0.15)
        assert all((v[j] >= 0).all() for v, _ in many) == family.positive
    twice, doubled = draw_members(families, np.random.default_rng(1), 2.0)
    assert doubled == pytest.approx(2 * spreads)
    assert np.concatenate(twice) == pytest.approx(2 * np.concatenate(values))


def test_imperfections_have_a_stream_of_their_own(robot, plan):
    """The runs are the same with tiny ones and without, each run has its own, company does not matter."""
    laboratory, part = tt.Laboratory(robot, "wii"), plan.take(plan.placement <= 4)
    streams = [stream_of(SEED, run) for run in range(3)]
    ordinary: Any = source_of(laboratory, part, None, "statics", 1e-7)(streams)
    exact: Any = source_of(laboratory, part, None, "statics")([stream_of(SEED, run) for run in range(3)])
    for one, other in zip(ordinary, exact, strict=True):
        assert one.measurements.cell_forces == pytest.approx(other.measurements.cell_forces, abs=1e-3)
        assert one.truth.mass == pytest.approx(other.truth.mass)
    source: Any = source_of(laboratory, part, 0.1, "statics", 1.0)
    together = source([stream_of(SEED, run) for run in range(2)])
    (alone,) = source([stream_of(SEED, 1)])
    np.testing.assert_array_equal(alone.measurements.cell_forces, together[1].measurements.cell_forces)
    np.testing.assert_array_equal(alone.base, together[1].base)
    assert np.abs(together[0].base - together[1].base).max() > 1e-3


def test_the_truth_follows_the_lengths_of_the_links(robot, plan):
    part = plan.take(plan.placement <= 3)
    laboratory = tt.Laboratory(robot, "wii")
    outcome: Any = source_of(laboratory, part, None, "statics", 1.0)([stream_of(SEED, 0)])[0]
    _, _, members = stream_of(SEED, 0).spawn(3)
    its_own = drawn(laboratory, 1.0, members)
    assert outcome.base == pytest.approx(its_own.true_base_parameters(part))
    lengths = [i for i in its_own.hidden if i.effect.name == "link-length"]
    changed = outcome.base - laboratory.true_base_parameters(part)
    assert changed == pytest.approx(
        dataclasses.replace(laboratory, hidden=tuple(lengths)).true_base_parameters(part)
        - laboratory.true_base_parameters(part)
    )
    assert np.abs(changed).max() > 1e-5


def test_a_laboratory_that_cannot_be_built_fails_its_run_alone(robot, plan):
    part = plan.take(plan.placement <= 3)
    outcomes = source_of(tt.Laboratory(robot, "wii"), part, None, "statics", 1e6)([stream_of(SEED, 0)])
    assert isinstance(outcomes[0], str)


def test_a_validation_in_an_ordinary_laboratory(validated, plan, robot, tmp_path):
    assert validated.identification.estimator == "self-calibrating"
    assert validated.verdict == "pass", [c for c in validated.checks if c.result == "fail"]
    hidden = validated.simulation.effects
    assert {i.effect.name for i in hidden} >= {"encoder-offset", "link-length", "cell-gain", "tilt"}
    names = [check.name for check in validated.checks]
    assert "correlation (12, 13)" in names
    assert "correlation (12, 13), estimate" in names
    validated.save(tmp_path / "run")
    assert json.loads((tmp_path / "run" / "run.json").read_text())["configuration"]["imperfections"] == 1.0
    effects = json.loads((tmp_path / "run" / "truth.json").read_text())["effects"]
    assert len(effects) == len(hidden)
    assert tt.Validation.load(tmp_path / "run", robot).imperfections == 1.0
    again = drawn(tt.Laboratory(robot, "wii"), 1.0, single_stream(SEED))
    assert [str(i) for i in again.hidden] == [str(i) for i in hidden]
    plain: Any = validated.least_squares
    assert plain.estimator == "least-squares"
    text = " ".join(" ".join(map(str, validated.tables())).split())
    assert f"sigma per axis (eq. 14) {1e3 * plain.full.sigma:.3f} mm" in text


def test_an_identification_is_read_as_it_was_written(validated, robot, tmp_path):
    own = validated.identification
    own.save(tmp_path / "fit")
    read = tt.Identification.load(tmp_path / "fit", robot)
    assert repr(read) == repr(own)
    assert read.to_json() == own.to_json() == json.loads((tmp_path / "fit" / "result.json").read_text())
    assert read["torso.x"] == own["torso.x"]
    refuse("result.json: cannot read", tt.Identification.load, tmp_path, robot)


def test_what_a_laboratory_hides_has_the_names_that_the_estimator_gives(validated, robot):
    hidden = {name: v for m in ordinary_members(preset_rig("wii", robot), np.random.default_rng(1))
              for name, v in m.named_values.items()}  # fmt: skip
    families = validated.identification.calibration.families
    assert list(hidden) == [label for each in families for label in each.family.labels]
    assert "plate-translation:left, x" in hidden
    assert set(validated.identification.full.unseen.labels) <= set(hidden)


def test_the_mass_comes_from_the_calibration(validated):
    """The cells weigh with gains of their own; the scale does not."""
    mass, error = validated.identification.mass
    assert error == pytest.approx(0.02, rel=0.1)
    assert abs(mass - validated.true_mass) < 4 * error


def test_the_data_distinguish_more_than_the_estimate_is_sure_of(validated, nominal):
    found: Any = validated.identification.calibration
    extra = found.covariance - found.unseen.covariance
    assert extra == pytest.approx(extra.T)
    assert np.linalg.eigvalsh(extra).min() > -1e-12 * np.linalg.eigvalsh(extra).max()
    assert np.linalg.eigvalsh(found.data_covariance).min() > 0
    assert (np.diag(extra) > 0.01 * np.diag(found.covariance)).any()
    exact = self_calibrate(
        observe(validated.measurements, nominal), dict.fromkeys([f.family.name for f in found.families], 0)
    )
    assert exact.unseen.labels == ()
    assert (exact.data_covariance == exact.covariance).all()


def test_a_plan_that_weakens_a_correlation_is_not_judged():
    data = np.array([[1.0, -0.9], [-0.9, 1.0]])
    (judged,) = data_correlation_checks(data, np.array([[1, -0.99], [-0.99, 1]]), [[1, 2]])
    assert judged.result == "fail"
    (skipped,) = data_correlation_checks(data, np.array([[1, -0.93], [-0.93, 1]]), [[1, 2]])
    assert skipped.result == "not evaluated"
    # Nor is the correlation of the angles, and then the limit is not printed as one that it passes.
    (held,) = correlation_checks(data, np.array([[1, -0.99], [-0.99, 1]]), [[1, 2]])
    assert (held.result, held.source.partition("; ")[2]) == ("fail", "below -0.95")
    (weak,) = correlation_checks(data, data, [[1, 2]])
    assert weak.result == "pass"
    assert weak.source.endswith("; not held to -0.95, which this plan weakens by itself")


def test_the_manifest_says_nothing_about_what_is_imperfect(validated, robot, plan, tmp_path):
    """Exact or not, laboratories state one data sheet, and no tolerances."""
    write_measurements(tmp_path / "ordinary", validated.measurements)
    exact = tt.Laboratory(robot, "wii").run(plan, SEED, "statics")
    write_measurements(tmp_path / "exact", exact.measurements)
    one, other = (
        json.loads((tmp_path / name / "manifest.json").read_text()) for name in ("ordinary", "exact")
    )
    assert one.keys() == other.keys()
    assert "tolerances" not in one
    drawn_anew = ("weighed_mass", "created", "tables")
    assert [key for key in one if key not in drawn_anew and one[key] != other[key]] == []
    assert one["weighed_mass"]["sd"] == other["weighed_mass"]["sd"]


def test_all_that_identifies_has_one_default():
    """What is validated is what users get, in the laboratories that it is for."""
    verbs = (tt.identify, tt.validate, tt.monte_carlo, judge)
    parameters = [inspect.signature(verb).parameters for verb in verbs]
    assert {one["estimator"].default for one in parameters} == {DEFAULT_ESTIMATOR}
    scales = [one["imperfections"].default for one in parameters if "imperfections" in one]
    assert scales == [ORDINARY] * 2
    assert Settings(1, 1, DEFAULT_ESTIMATOR, None).imperfections == ORDINARY
    assert inspect.signature(tt.simulate).parameters["imperfections"].default == 0


def test_the_verdict_fails_wrong_estimates(validated, robot, plan):
    """Estimates that are off by five standard errors, and standard errors of a third of their size."""
    run = drawn(tt.Laboratory(robot, "wii"), 1.0, single_stream(SEED)).run(plan, SEED, "statics")
    found, (mass, error) = validated.identification, validated.identification.mass
    for change in (
        {"value": found.full.value + 5 * np.sqrt(np.diag(found.full.covariance))},
        {"clustered_covariance": found.full.clustered_covariance / 9},
    ):
        full = dataclasses.replace(found.full, **change)
        wrong = dataclasses.replace(found, full=full, mass=(mass + 5 * error, error))
        failed = {c.name for c in evaluate(run, wrong, validated.truth) if c.result == "fail"}
        assert {"full model: all errors", "total mass"} <= failed


@pytest.mark.slow
def test_an_ordinary_laboratory_in_the_full_dynamics(robot, plan):
    """Springs in all joints come to rest, with the readings of statics."""
    part = plan.take(plan.placement <= 2)
    laboratory = drawn(tt.Laboratory(robot, "force-plate"), 1.0, single_stream(SEED))
    moving, static = (laboratory.run(part, 1, engine).measurements for engine in ("dynamics", "statics"))
    assert len(moving) > 0.8 * len(static)
    assert np.abs(moving.cell_forces.sum(axis=1).mean() - static.cell_forces.sum(axis=1).mean()) < 0.5


@pytest.mark.parametrize(("sensors", "plates"), [("foot-ft", False), ("plate-ft", True)])
def test_a_sensor_in_a_foot_has_no_record_of_its_place_that_could_be_wrong(robot, sensors, plates):
    names = {m.effect.name for m in ordinary_members(preset_rig(sensors, robot), np.random.default_rng(1))}
    assert ("plate-translation" in names, "plate-yaw" in names) == (plates, plates)
    assert "encoder-offset" in names


def test_a_monte_carlo_records_its_imperfections(robot, plan, tmp_path):
    laboratory, part = tt.Laboratory(robot, "wii"), plan.take(plan.placement <= 5)
    tt.monte_carlo(laboratory, part, runs=2, seed=SEED, out=tmp_path / "runs", workers=1, imperfections=0.5)
    read = MonteCarlo.load(tmp_path / "runs", robot)
    assert read.imperfections == read.document.settings.imperfections == 0.5

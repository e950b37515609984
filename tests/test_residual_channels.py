"""Residual channels of the nominal model, their noise, and patterns and candidates in noise alone."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import t as student

from tests.effect_changes import DISCOVERY_SEED as SEED
from tests.effect_changes import measured
from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.discovery.candidates import Fitted, candidates
from tulip_testbed.discovery.columns import candidate_columns
from tulip_testbed.discovery.detectability import by_kind
from tulip_testbed.discovery.evidence import ranked
from tulip_testbed.discovery.joint_fit import Data, joint_fit, propagation
from tulip_testbed.discovery.patterns import patterns
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import fields, packed, residuals, sensitivity, unpacked
from tulip_testbed.identification.residual_noise import cell_by_twist, noise_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics


@pytest.fixture(scope="module")
def solved_plan(robot, plan):
    return {name: solve_plan(preset_rig(name, robot), plan) for name in ("ideal", "force-plate", "wii")}


@pytest.fixture(scope="module")
def exact(solved_plan, nominal):
    (run,) = run_statics(solved_plan["ideal"], [np.random.SeedSequence(SEED)])
    return observe(run.measurements, nominal)


def test_the_nominal_laboratory_leaves_no_residual(exact, nominal):
    left = residuals(exact, nominal.value)
    for number in np.unique(exact.stance):
        left[exact.stance == number, 8:] -= left[exact.stance == number, 8:].mean(axis=0)
    left[:, 3:5] *= exact.on_four_cells
    size = np.sqrt((left**2).mean(axis=0))
    assert (size < [2e-5, 2e-5, 1e-3, 1e-3, 1e-3, 5e-6, 2e-5, 2e-5, 5e-6, 5e-6, 2e-5]).all()


def test_the_slopes_of_the_residuals_are_their_differences(exact, nominal):
    slope, start, at = sensitivity(exact, nominal.value), packed(exact), fields(exact)
    for name, where in at.items():
        step = 1e-2 if name in ("cells", "lift") else 1e-5
        for k in range(where.start, where.stop):
            way = step * (np.arange(start.shape[1]) == k)
            ahead, behind = (residuals(unpacked(exact, start + s * way), nominal.value) for s in (1, -1))
            np.testing.assert_allclose(slope[..., k], (ahead - behind) / (2 * step), atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["force-plate", "wii"])
def test_noise_alone_is_what_the_noise_model_says_and_patterns_in_it_are_rare(solved_plan, nominal, preset):
    """Chi-square over 25 experiments of some 1,400 degrees of freedom; 99.9 % bounds. A least p of a pattern
    below 0.1 in more than 9 of them has a probability below 0.1 %."""
    runs = run_statics(solved_plan[preset], [np.random.SeedSequence([SEED, k]) for k in range(25)])
    ratios, least = [], []
    for run in runs:
        observed = observe(run.measurements, nominal)
        linear = linear_model(observed, noise_of(observed))
        ratios.append(float(linear.residual @ linear.residual) / linear.dof)
        least.append(patterns(linear, linear.residual, np.zeros((len(linear.residual), 0)))[0].p)
    assert abs(np.mean(ratios) - 1) < 0.02
    assert np.std(ratios) < 1.7 * np.sqrt(2 / linear.dof)
    assert sum(p < 0.1 for p in least) <= 9


@pytest.mark.parametrize(
    ("name", "target", "value"),
    [
        ("cell-tare", "left.front_left", (5.0,)),
        ("cell-gain", "right.rear_left", (0.1,)),
        ("cell-drift", "left.rear_right", (3.0,)),
    ],
)
def test_a_faulty_cell_is_no_noise(robot, plan, nominal, name, target, value):
    observed = observe(measured(robot, plan, "force-plate", (name, target, value)), nominal)
    assert cell_by_twist(observed) == pytest.approx(noise_of(observed).cell, rel=0.15)


@pytest.mark.parametrize(
    ("name", "target", "value"),
    [
        ("cell-crosstalk", "", (0.04,)),
        ("cell-hysteresis", "", (0.02,)),
        ("thermal-gain-drift", "", (0.05,)),
        ("cell-gain", "left.front_left", (0.1,)),
        ("swapped-cells", "right", (0.0, 1.0)),
        ("swapped-cells", "left", (1.0, 2.0)),
        ("logged-command", "right_knee", (1.0,)),
    ],
)
def test_what_an_instrument_does_leaves_the_noise_as_it_was(solved_plan, nominal, name, target, value):
    """Chi-square at the right effect is that of the same experiment without it.

    A whitening that follows the readings' scale, as one may think it should, is off by 15 to 360 here;
    without noise of the motor that tells an angle, by 60.
    """
    plain = solved_plan["force-plate"]
    effect = catalogue()[name]
    sizes = []
    for rig in (plain.rig, effect.inject(plain.rig, target, value)):
        stream = np.random.SeedSequence([SEED, 1])
        observed = observe(
            run_statics(dataclasses.replace(plain, rig=rig), [stream])[0].measurements, nominal
        )
        if rig is plain.rig:
            terms = ()
        else:
            (found,) = (c for c in candidates(observed) if (c.effect.name, c.target) == (name, target))
            point = 0 if effect.sizes else [tuple(s) for s in found.settings].index(value)
            terms = (Fitted(found, point, np.array(value if effect.sizes else ())),)
        fitted = joint_fit(Data(observed, noise_of(observed)), terms)
        sizes.append(fitted.chi_square - fitted.linear.dof)
    assert abs(sizes[1] - sizes[0]) < 10


def test_derivatives_by_readings_are_those_of_a_removal(solved_plan, nominal):
    """A compliance is removed by the load that the cells show, an offset by nothing that is read."""
    (run,) = run_statics(solved_plan["wii"], [np.random.SeedSequence(SEED)])
    observed = observe(run.measurements, nominal)
    by_label = {one.label: one for one in candidates(observed)}
    compliance, offset = (
        Fitted(by_label[f"{name}:right_knee"], 0, np.array([size]))
        for name, size in (("joint-compliance", 1e-3), ("encoder-offset", 0.01))
    )
    assert propagation(observed, (offset,)) is None
    found, at = propagation(observed, (compliance,)), fields(observed)
    assert found is not None
    knee, plain = observed.tree.joints.index("right_knee"), observed.torques
    for name, part, step in (("joint_angles", "angles", 1e-5), ("plate_poses", "plates", 1e-5)):
        moved = getattr(observed, name).copy()
        moved.reshape(len(observed), -1)[:, 2] += step
        own = (observed.changed(**{name: moved}).torques - plain)[:, knee] / step
        assert np.abs(own).max() > 1
        assert found[:, knee, at[part].start + 2] == pytest.approx(1e-3 * own, abs=1e-6)
    assert not found[:, at["plates"], at["cells"]].any()


@pytest.mark.slow
def test_columns_hold_no_noise_of_the_residuals(solved_plan, nominal):
    """Sizes of every candidate over noise alone: no systematic pull on any (t over 20 runs, 0.05 %)."""
    pulls = []
    for run in run_statics(solved_plan["wii"], [np.random.SeedSequence([SEED, 100 + k]) for k in range(20)]):
        observed = observe(run.measurements, nominal)
        plain = linear_model(observed, noise_of(observed))
        columns = candidate_columns(plain, [c for c in candidates(observed) if c.effect.name == "cell-gain"])
        by_label = {one.label: one for one in ranked([columns], plain.residual)}
        pulls.append([by_label[one.label].sizes[0] for one in columns.candidates])
    t = np.mean(pulls, axis=0) / np.std(pulls, axis=0, ddof=1) * np.sqrt(len(pulls))
    assert (np.abs(t) < student.ppf(1 - 0.00025, len(pulls) - 1)).all()


def test_every_effect_is_shown_or_hides_or_shows_weakly(discovered):
    """What is in no list is found at a plausible size with nine in ten."""
    found = discovered.discovery
    weak = {one.candidate.label: one.multiple for one in found.selection.weak}
    hidden = {one.candidate.label for one in found.undetectable}
    assert not hidden & set(weak)
    assert min(weak.values()) > 1
    everything = {one.label for one in candidates(found.observed)}
    assert hidden | set(weak) < everything
    assert "encoder-offset:right_knee" in everything - hidden - set(weak)
    kinds = by_kind([one.candidate for one in found.undetectable], found.observed)
    assert kinds["payload"] == []
    assert kinds["unsettled"] == []
    assert [line for line in discovered.story if "cannot detect" in line]

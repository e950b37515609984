"""What the estimators know of the robot: slopes, closed chain, masses, boxes."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import linprog

from tests.synthetic import WII
from tests.test_refusals import refuse
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.estimators import MIXED_MODEL, estimate_by
from tulip_testbed.identification.estimators.consistent import corner_parameters
from tulip_testbed.identification.estimators.errors_in_variables import bounded_excess
from tulip_testbed.identification.estimators.prior import CENTER_SD, MASS_SD, identifiable_masses
from tulip_testbed.identification.loop_closure import encoder_sd_by_closure
from tulip_testbed.identification.statistics import standard_errors


@pytest.mark.parametrize("sd", [1e-4, 3e-3])
def test_the_closed_chain_shows_the_encoders_errors(parameters, robot, plan, sd):
    """150 postures leave about 350 degrees of freedom, an s.d. known to 4 %: bounds at 4 of them. Constant
    offsets do not count."""
    rng = np.random.default_rng(131)
    swing = parameters.tree.frame(robot.swing_foot)
    offset = 2e-3 * rng.standard_normal(12)
    angles = plan.joint_angles + sd * rng.standard_normal(plan.joint_angles.shape)
    for measured in (angles, angles + offset):
        found = encoder_sd_by_closure(parameters.tree, parameters.base, swing, measured, plan.placement)
        assert found == pytest.approx(sd, rel=0.16)


def test_too_few_postures_show_nothing_of_the_encoders(parameters, robot, plan):
    swing = parameters.tree.frame(robot.swing_foot)
    arguments = (parameters.tree, parameters.base, swing, plan.joint_angles)
    assert encoder_sd_by_closure(*arguments, np.arange(150)) is None


def test_no_more_than_half_is_taken_for_encoder_errors():
    information = np.diag([4.0, 1.0])
    small, large = np.diag([0.4, 0.1]), np.diag([0.4, 2.0])
    assert bounded_excess(small, information) == pytest.approx(small)
    assert bounded_excess(large, information) == pytest.approx(large / 4)


def test_masses_that_statics_gives(parameters, nominal, model, foreign):
    """TULip: the total alone. Moving mass between links along an unseen direction changes no measurement."""
    visible = identifiable_masses(parameters)
    assert visible.combinations == pytest.approx(np.ones((1, 13)))
    assert "no single link mass" in visible.sentence
    total = np.zeros((13, 4))
    total[:, 0] = 1.0
    _, _, turned = np.linalg.svd(np.vstack([parameters.from_standard, total.ravel()]))
    unseen = turned[26:].reshape(-1, 13, 4)
    standard = standard_parameters(model)
    for direction in unseen:
        assert parameters.values(standard + 0.1 * direction) == pytest.approx(nominal.value, abs=1e-9)
    assert (np.abs(unseen[:, :, 0]).max(axis=0) > 1e-3).all()
    assert identifiable_masses(base_parameters(foreign["humanoid"])).alone == ("right_foot", "left_foot")


def drawn(nominal, model, rng):
    """A robot from the prior: its mass and centre of mass per link, (n, 4), and it as a `Nominal`."""
    standard = standard_parameters(model)
    mass, center = standard[:, 0], standard[:, 1:] / standard[:, :1]
    mass = mass * (1 + MASS_SD * rng.standard_normal(len(mass)))
    center = center + CENTER_SD * rng.standard_normal(center.shape)
    standard = np.column_stack([mass, mass[:, None] * center])
    truth = dataclasses.replace(nominal, value=nominal.parameters.values(standard), mass=float(mass.sum()))
    return np.column_stack([mass, center]), truth


def test_the_posterior_is_right_about_its_errors(bench, nominal, model):
    """30 robots from the prior, 52 quantities each: the mean of z^2 is 1 within 0.15, about four of its s.d.
    (quantities correlate), masses and centres each."""
    squares, shares = [], []
    for seed in range(30):
        rng = np.random.default_rng([132, seed])
        truth, robot = drawn(nominal, model, rng)
        data = dataclasses.replace(bench, nominal=robot).draw(rng, **WII)
        found = estimate_by(data, "prior").standard
        assert found is not None
        error = np.column_stack([found.mass, found.center]) - truth
        squares.append((error / np.column_stack([found.mass_error, found.center_error])) ** 2)
        shares.append(np.column_stack([found.mass_share, found.center_share]))
    mean = np.mean(squares, axis=(0, 1))
    assert np.abs(mean - 1).max() < 0.25
    assert np.mean(squares) == pytest.approx(1, abs=0.15)
    assert 0 <= np.min(shares) <= np.max(shares) <= 1
    assert np.mean(shares, axis=0)[0, 0] > 0.5  # the torso's mass: most of the total


def test_consistent_estimates_are_reachable_and_nearer(bench):
    """Every estimate is a robot's (by a linear program), and errors shrink; nine in ten at least must."""
    better = []
    for seed in range(10):
        data = bench.draw(np.random.default_rng([134, seed]), **WII)
        free, found = estimate_by(data, MIXED_MODEL), estimate_by(data, "consistent")
        reachable = corner_parameters(data)
        rows = np.vstack([reachable, np.ones(reachable.shape[1])])
        program = linprog(
            np.zeros(rows.shape[1]), A_eq=rows, b_eq=np.append(found.value, 1.0), bounds=(0, None)
        )
        assert program.status == 0
        errors = [np.linalg.norm(e.value - bench.nominal.value) for e in (free, found)]
        better.append(errors[1] < errors[0])
    assert sum(better) >= 9


def test_a_feasible_estimate_is_left_alone(bench):
    data = bench.draw(np.random.default_rng(135), cell=1e-3, placement=1e-6, mark=1e-6, encoder=0.0)
    free, found = estimate_by(data, MIXED_MODEL), estimate_by(data, "consistent")
    assert np.abs((found.value - free.value) / standard_errors(free.covariance)).max() < 1e-3


@pytest.mark.parametrize("name", ["prior", "consistent"])
def test_knowledge_of_the_robot_needs_a_robot(bench, name):
    data = bench.draw(np.random.default_rng(136), **WII)
    refuse("found no robot", estimate_by, dataclasses.replace(data, robot=None), name)

"""Sizes of effects that belong to no family: their prior, and their uncertainty in the base parameters."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import cauchy, norm

from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.effects.instance import instances_of
from tulip_testbed.effects.size_prior import log_tail, prior_sd
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.observation import observe

TRUE = 130.0  # N/m, more than six times what is plausible
SPRING = f"tether-spring={TRUE}"


@pytest.fixture(scope="module")
def held_back(robot, plan):
    laboratory = Laboratory(robot, "wii").with_effects(SPRING)
    return laboratory.run(plan, 11, "statics")


@pytest.fixture(scope="module")
def joint(held_back, robot, nominal):
    """Base parameters, families and the spring in one estimate, from a spring of a plausible size on."""
    start = instances_of("tether-spring=20", robot)
    return self_calibrate(observe(held_back.measurements, nominal), None, start)


@pytest.mark.parametrize("size", [0.0, 0.3, -2.0, 50.0])
def test_the_normal_distribution_touches_the_prior(size):
    plausible, step = np.array(0.7), 1e-5
    sd = prior_sd(plausible, np.array(size))
    slopes = [
        (one.logpdf(size + step, scale=scale) - one.logpdf(size - step, scale=scale)) / (2 * step)
        for one, scale in ((cauchy, 0.7), (norm, sd))
    ]
    assert slopes[0] == pytest.approx(slopes[1], abs=1e-6)
    ratio = cauchy.logpdf(size, scale=0.7) - norm.logpdf(size, scale=sd)
    assert log_tail(plausible, np.array(size)) == pytest.approx(ratio)
    elsewhere = np.linspace(-60, 60, 241)
    below = norm.logpdf(elsewhere, scale=sd) + log_tail(plausible, np.array(size))
    assert (below <= cauchy.logpdf(elsewhere, scale=0.7) + 1e-9).all()


def test_a_size_far_beyond_what_is_plausible_is_not_drawn_to_zero(joint):
    (spring,), ((error,),) = joint.effects, joint.effect_errors
    assert error > 0.4 * 20  # so that a normal prior would draw it
    assert abs(spring.values[0] - TRUE) < 3 * error


def test_the_uncertainty_of_a_correction_is_that_of_the_joint_estimate(held_back, joint, robot, plan):
    known = identify(held_back.measurements, robot, adopted=joint.effects).calibration
    exact = [dataclasses.replace(one, intervals=()) for one in joint.effects]
    taken = identify(held_back.measurements, robot, adopted=exact).calibration
    assert known is not None
    assert taken is not None
    errors = [np.sqrt(np.diag(one.covariance)) for one in (joint, known, taken)]
    assert errors[1] == pytest.approx(errors[0], rel=0.15)
    assert (errors[2] < 0.5 * errors[0]).any()
    off = (known.theta - held_back.laboratory.true_base_parameters(plan)) / errors[1]
    assert np.sqrt((off**2).mean()) < 1.7
    assert known.sources[-1] == "corrections"
    assert known.shares.sum(axis=0) == pytest.approx(np.ones(len(known.theta)))

"""The estimate from a robot that moves: forces of motion, inertial parameters, noise that lasts."""

import dataclasses

import numpy as np
import pytest

from tests.moving_robots import moving, random_robot
from tulip_testbed.identification import inertial_wrench
from tulip_testbed.identification.inertial_wrench import beyond_weight, inertial_parameters
from tulip_testbed.identification.noise_in_time import WHITE, NoiseInTime, decorrelation, noise_in_time_of
from tulip_testbed.identification.nominal import nominal_robot

STEP, WINDOW = 0.25, 0.5  # s, from row to row, of a row


def rms(values):
    return np.sqrt((values**2).mean(axis=0))


def slow_motion(robot, rng, count):
    m = moving(robot, rng, count)
    rates, accelerations = np.array(m.joint_rates), np.array(m.joint_accelerations)
    slower = {"joint_rates": 0.3 * rates, "joint_accelerations": 0.1 * accelerations}
    return dataclasses.replace(m, window=np.full(len(m), WINDOW), **slower)


def test_what_motion_adds_is_differentiated_by_inertial_parameters(robot, nominal, monkeypatch):
    rng = np.random.default_rng(400)
    m, step = slow_motion(robot, rng, 20), 1e-5
    found, cad = beyond_weight(nominal, m), inertial_parameters(robot.model)
    off, deviates = rng.standard_normal(found.slope.shape[2]), rng.standard_normal(found.unknown.shape[2])
    known, _ = inertial_wrench._given_base_parameters(nominal, cad)
    changed = cad + step * (known @ off + found.directions @ deviates).reshape(cad.shape)
    assert nominal.parameters.values(changed[:, :4]) == pytest.approx(nominal.value + step * off, abs=1e-12)
    monkeypatch.setattr(inertial_wrench, "inertial_parameters", lambda model: changed)
    change = (beyond_weight(nominal, m).by_cad - found.by_cad) / step
    expected = found.slope @ off + found.unknown @ deviates
    assert np.abs(change - expected).max(axis=0) == pytest.approx(0, abs=1e-3 * np.abs(expected).max())


def test_most_of_what_motion_adds_follows_from_the_base_parameters(robot, nominal):
    """Of a robot 10 % off, against the same motion of the true one."""
    rng = np.random.default_rng(405)
    m, other = slow_motion(robot, rng, 60), random_robot(robot, rng, 0.1)
    other.model.body_mass[:] *= robot.model.body_mass.sum() / other.model.body_mass.sum()
    by_nominal, by_true = (beyond_weight(nominal_robot(one), m) for one in (robot, other))
    change = by_true.by_cad - by_nominal.by_cad
    true = inertial_parameters(other.model)[:, :4]
    left = change - by_nominal.slope @ (nominal.parameters.values(true) - nominal.value)
    assert (rms(left) < [0.5, 0.5, 0.02, 0.02, 0.02] * rms(change)).all()
    flat = by_nominal.unknown[:, :2].reshape(2 * len(m), -1)
    deviates = np.linalg.lstsq(flat, left[:, :2].ravel(), rcond=None)[0]
    assert rms(left[:, :2].ravel() - flat @ deviates) < 0.25 * rms(left[:, :2].ravel())


def test_a_robot_that_is_held_adds_nothing(robot):
    m = dataclasses.replace(
        moving(robot, np.random.default_rng(401), 4), joint_rates=None, joint_accelerations=None
    )
    assert not len(beyond_weight(nominal_robot(robot), m).by_cad)


def series(rng, lasting, segments=6, rows=60, kinds=3):
    time, segment = STEP * np.arange(segments * rows), np.repeat(np.arange(segments), rows)
    root = np.linalg.cholesky(lasting.correlation(time[:rows], WINDOW))
    noise = [root @ rng.standard_normal((rows, kinds)) for _ in range(segments)]
    return np.concatenate(noise), time, segment, WINDOW


@pytest.mark.parametrize("lasting", [NoiseInTime(0.6, 2.0), NoiseInTime(0.9, 16.0), NoiseInTime(0.3, 1.0)])
def test_how_long_noise_lasts_is_found(lasting):
    found = noise_in_time_of(*series(np.random.default_rng(402), lasting))
    assert found.share == pytest.approx(lasting.share, abs=0.15)
    assert abs(np.log2(found.seconds / lasting.seconds)) <= 1


def test_how_long_noise_lasts_is_found_from_the_rows_that_have_it():
    lasting = NoiseInTime(0.9, 4.0)
    noise, time, segment, window = series(np.random.default_rng(405), lasting, kinds=4)
    noise[np.random.default_rng(406).random(len(noise)) < 0.3, 3] = 0.0
    found = noise_in_time_of(noise, time, segment, window)
    assert found == noise_in_time_of(noise[:, :3], time, segment, window)
    assert found.share == pytest.approx(lasting.share, abs=0.1)


def test_white_noise_does_not_last():
    rng = np.random.default_rng(403)
    assert all(noise_in_time_of(*series(rng, WHITE)) == WHITE for _ in range(5))


def test_rows_become_uncorrelated_over_the_rows_that_have_a_residual():
    lasting, rng = NoiseInTime(0.8, 4.0), np.random.default_rng(404)
    _, time, segment, _ = series(rng, lasting, segments=3, rows=40)
    used = np.ones((len(time), 2), bool)
    used[:, 1] = rng.random(len(time)) < 0.7
    found = decorrelation(time, segment, WINDOW, lasting, used)
    unit = np.repeat(np.eye(len(time))[:, None], 2, axis=1)
    whole = (segment[:, None] == segment) * lasting.correlation(time, WINDOW)
    for number, having in enumerate(used.T):
        both = np.outer(having, having)
        root = found(unit * having[:, None, None])[:, number]
        assert root @ (both * whole) @ root.T == pytest.approx(np.diag(having.astype(float)), abs=1e-9)
        assert found.back(unit)[:, number] == pytest.approx(found(unit)[:, number].T, abs=1e-12)
        assert found.correlated(unit)[:, number][both] == pytest.approx(whole[both], abs=1e-12)


def test_effective_rows_are_those_of_a_continuous_record():
    """Of a record of L seconds whose noise lasts T, a constant has the information of 1 + L / (2 T) rows."""
    time, segment, lasts = STEP * np.arange(480), np.repeat([1, 2], 240), 8.0
    used = np.ones((480, 2), bool)
    used[::3, 1] = False
    slow = decorrelation(time, segment, WINDOW, NoiseInTime(1.0, lasts), used)
    assert slow.effective_rows == pytest.approx(2 * (1 + 240 * STEP / (2 * lasts)), rel=0.03)
    white = decorrelation(2 * time, segment, WINDOW, WHITE, used)
    assert white.effective_rows == pytest.approx(480)

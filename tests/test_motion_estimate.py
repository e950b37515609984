"""The estimate from a robot that moves: forces of motion, inertial parameters, noise that lasts."""

import copy
import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from tests.moving_robots import by_inverse_dynamics, moving, random_robot
from tulip_testbed.calibration.lasting_noise import SECONDS, SHARES, likeliest_noise
from tulip_testbed.calibration.linear_problem import LinearProblem
from tulip_testbed.calibration.linearisation import unseen_wrench
from tulip_testbed.calibration.reml import fit, given
from tulip_testbed.effects.motion_effects import LAG
from tulip_testbed.identification import inertial_wrench
from tulip_testbed.identification.base_parameters import common_support, standard_parameters
from tulip_testbed.identification.inertial_wrench import (
    JERK_NOISE,
    acceleration_sd,
    beyond_weight,
    by_accelerations,
    inertial_parameters,
)
from tulip_testbed.identification.joint_loads import UNSEEN, joint_loads
from tulip_testbed.identification.noise_in_time import WHITE, NoiseInTime, decorrelation
from tulip_testbed.identification.noise_structure import NoiseStructure, groups
from tulip_testbed.identification.nominal import PostureGeometry, nominal_robot
from tulip_testbed.identification.observation import CLOSURE, SIZE, TWISTS, observe
from tulip_testbed.measurements.logs.series_reduction import _weights
from tulip_testbed.sim.sensors import sample_series

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


def test_inertial_forces_grow_with_the_weighed_mass(robot, nominal):
    """A robot weighed as 1.2 times heavier, against one whose model is 1.2 times heavier."""
    m, other = (
        slow_motion(robot, np.random.default_rng(407), 10),
        replace(robot, model=copy.copy(robot.model)),
    )
    for values in (other.model.body_mass, other.model.body_inertia):
        values[:] *= 1.2
    weighed = replace(m, weighed_mass=(1.2 * nominal.mass, 0.0))
    found, expected = beyond_weight(nominal, weighed), beyond_weight(nominal_robot(other), m)
    for name in ("by_cad", "slope", "rate", "of_links", "directions"):
        ours, theirs = (abs(getattr(one, name)) for one in (found, expected))
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-9 * theirs.max(), err_msg=name)
    assert not np.allclose(found.by_cad[:, 2], beyond_weight(nominal, m).by_cad[:, 2], rtol=0.1)


@pytest.mark.parametrize(("slow", "quick"), [(1e-3, 0.0), (0.0, 1e-3)])
def test_accelerations_are_as_noisy_as_their_s_d(robot, slow, quick):
    """Of encoders with white noise, and with noise that lasts for seconds, on a robot at rest."""
    rng, count, seconds = np.random.default_rng(408), 30_000, 2.0
    read, _ = sample_series(np.zeros((count, 12)), (slow, quick, 0.0), 1, rng, 0.01, seconds)
    weights, powers, solve = _weights(0.01 * np.arange(50) - 0.245, WINDOW)
    windows = read.reshape(-1, 50, 12)
    left = windows - powers @ (solve @ windows)
    m = replace(
        slow_motion(robot, rng, len(windows)),
        joint_angles_sd=np.sqrt((left**2).sum(axis=1) / 46),
        samples=np.full(len(windows), 50.0),
    )
    foretold = acceleration_sd(m, slow, NoiseInTime(1.0 if slow else 0.0, seconds))
    assert (weights[2] @ windows).std() == pytest.approx(np.sqrt((foretold**2).mean()), rel=0.1)


@pytest.mark.parametrize("side", ["double", "right", "left"])
def test_forces_of_joints_that_are_accelerated_are_those_of_the_regressor(robot, side):
    m = replace(moving(robot, np.random.default_rng(410), 5), support=np.full(5, side))
    m = replace(m, joint_rates=None, joint_accelerations=np.zeros_like(m.joint_angles), window=np.zeros(5))
    nominal = nominal_robot(robot, common_support(m.support))
    step = 1e-3 * np.eye(len(m.joints))[:, None]
    after, before = (
        np.stack(
            [
                beyond_weight(nominal, replace(m, joint_accelerations=at + 0 * m.joint_angles)).by_cad
                for at in steps
            ],
            axis=2,
        )
        for steps in (step, -step)
    )
    found = by_accelerations(observe(m, nominal).geometry, m)
    for each, expected in zip(found.swapaxes(0, 1), ((after - before) / 2e-3).swapaxes(0, 1), strict=True):
        assert each == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_a_robot_that_is_held_adds_nothing(robot):
    m = dataclasses.replace(
        moving(robot, np.random.default_rng(401), 4), joint_rates=None, joint_accelerations=None
    )
    assert not len(beyond_weight(nominal_robot(robot), m).by_cad)


def test_friction_of_a_robot_that_moves_counts_once(robot, nominal):
    """At rest it opposes the loads of like postures alike, and counts as a multiple."""
    m = slow_motion(robot, np.random.default_rng(406), 4)
    held = dataclasses.replace(m, joint_rates=None, joint_accelerations=None)
    in_motion, at_rest = (unseen_wrench(observe(one, nominal)) for one in (m, held))
    assert in_motion == pytest.approx(UNSEEN)
    assert (at_rest > 3 * in_motion).all()


@pytest.mark.parametrize("which", ["tulip", "humanoid"])
def test_joints_of_a_robot_that_moves_bear_what_inverse_dynamics_need(which, robot, foreign):
    one, rng = robot if which == "tulip" else foreign[which], np.random.default_rng(409)
    m = dataclasses.replace(moving(one, rng), support=np.array(["right", "left"] * 3))
    nominal = nominal_robot(one, common_support(m.support))
    count, joints, standard = len(m), len(m.joints), standard_parameters(one.model)
    down, place, expected = np.zeros((count, 2)), np.zeros((count, 2, 3)), np.empty((count, joints))
    for row, side in enumerate([0, 1] * 3):
        foot, sole = (one.stance_foot, one.swing_foot)[side], nominal.points[side]
        motion = m.joint_angles[row], m.joint_rates[row], m.joint_accelerations[row]
        wrench, *_, expected[row] = by_inverse_dynamics(one, foot, sole, *motion)
        down[row, side], place[row, side, :2] = wrench[2], np.array([-wrench[4], wrench[3]]) / wrench[2]
    found = joint_loads(
        PostureGeometry(nominal, nominal.parameters.tree, m.joint_angles, m.support, standard),
        standard[:, 0].sum() * m.gravity,
        down,
        place,
        cells=np.zeros((count, 2, 4, 2)),
        bears=np.ones((2, 4)),
        cell_sd=0.0,
        place_sd=0.0,
        both=np.zeros(count, bool),
        servo_stiffness=np.ones(joints),
        servo_gain=np.ones(joints),
        sag=np.ones(count),
        friction=np.zeros((count, joints)),
        of_links=beyond_weight(nominal, m).of_links,
        pushes=np.zeros((count, 2)),
    )
    # The load turns a joint the other way than its drive. Rows last no time, so that means are values.
    assert found.torques == pytest.approx(-expected, abs=1e-9 * np.abs(expected).max())


def test_late_contacts_read_what_inverse_dynamics_needed_before(robot):
    """By an oracle at two times, of a motion whose jerk is known."""
    m = replace(moving(robot, np.random.default_rng(408), 4), support=np.full(4, "right"), window=np.ones(4))
    jerks, step = np.random.default_rng(411).standard_normal(m.joint_angles.shape), 1e-3
    m = replace(m, joint_jerks=jerks, joint_angles_sd=0 * jerks, samples=np.full(4, 50.0))
    nominal = nominal_robot(robot, "right")
    q, dq, ddq = m.joint_angles, m.joint_rates, m.joint_accelerations
    weight, foot, read = nominal.mass * m.gravity, (robot, robot.stance_foot, nominal.points[0]), []
    for at in (step, -step):
        there = q + at * dq + at**2 / 2 * ddq + at**3 / 6 * jerks, dq + at * ddq + at**2 / 2 * jerks
        motions = zip(*there, ddq + at * jerks, strict=True)
        w = np.array([by_inverse_dynamics(*foot, *one)[0] for one in motions])
        read.append(np.column_stack([-w[:, 4] / w[:, 2], w[:, 3] / w[:, 2], w[:, 2], w[:, :2] / weight]))
    expected = (read[0] - read[1]) / (2 * step)
    observed = observe(m, nominal)
    off = np.abs(observed.motion.rate - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert (off < 1e-4).all(), off
    late = LAG.remove(observed, "", (0.02,))
    assert late.shift - observed.shift == pytest.approx(-0.02 * expected[:, :2], rel=1e-3)


def test_noise_of_the_jerks_makes_no_lag_too_short(robot, nominal):
    m, rng = slow_motion(robot, np.random.default_rng(412), 300), np.random.default_rng(413)
    jerks, noise = rng.standard_normal((2, *m.joint_angles.shape))
    m = replace(m, joint_rates=0 * jerks, joint_accelerations=0 * jerks, samples=np.full(len(m), 50.0))
    sd = np.full(jerks.shape, np.sqrt(50 * 0.25**6 / JERK_NOISE))
    true, found, plain = (
        beyond_weight(nominal, replace(m, joint_jerks=j, joint_angles_sd=s)).rate[:, :2]
        for j, s in ((jerks, 0 * sd), (jerks + noise, sd), (jerks + noise, 0 * sd))
    )
    slope, too_short = ((one * true).sum() / (one**2).sum() for one in (found, plain))
    assert slope == pytest.approx(1.0, abs=0.1)
    assert too_short < 0.6


def test_noise_lasts_beyond_a_stance_but_not_where_its_constant_is_unknown(robot, nominal):
    m = slow_motion(robot, np.random.default_rng(407), 60)
    m = dataclasses.replace(m, time=STEP * np.arange(len(m)), placement=np.ones(len(m), int))
    observed = observe(m, nominal).changed(noise_in_time=NoiseInTime(0.9, 4.0))
    last = np.flatnonzero(np.diff(observed.stance))[0]
    assert observed.segment[last] == observed.segment[last + 1]
    one, in_time = np.zeros((len(m), SIZE)), observed.in_time
    one[last] = 1.0
    assert in_time is not None
    after = in_time.correlated(one)[last + 1]
    assert (after[: TWISTS.start] > 0.5).all()  # not all boards rest on four cells
    assert not after[CLOSURE].any()


START = NoiseInTime(0.9, 4.0)
SEGMENTS, ROWS, KINDS, SLOW = 16, 60, 2, 3  # slow functions of time in each segment, whose sizes nobody knows


def series(rng, lasting):
    """Return a linear problem with noise of s.d. 2, and what makes its rows uncorrelated.

    The last residual is one of the closure.
    """
    time, segment = STEP * np.arange(SEGMENTS * ROWS), np.repeat(np.arange(SEGMENTS), ROWS)
    roots = [
        np.linalg.cholesky(one.correlation(time[:ROWS], WINDOW)) for one in (lasting, lasting.of_closure())
    ]
    slow = np.polynomial.legendre.legvander(np.linspace(-1, 1, ROWS), SLOW - 1)
    columns = np.kron(np.kron(np.eye(SEGMENTS), slow), np.eye(KINDS)).reshape(len(time), KINDS, -1)
    white = rng.standard_normal((SEGMENTS, ROWS, KINDS))
    noise = 2 * np.einsum("kij,sjk->sik", roots, white).reshape(-1, KINDS)
    m, p, nothing = len(time), columns.shape[2], np.zeros((len(time), KINDS, 0))
    kept = np.ones((m, KINDS), bool)

    def decorrelated(one):
        parts = ((segment, one, [0]), (segment, one.of_closure(), [1]))
        return decorrelation((time, WINDOW, kept), parts)

    problem = LinearProblem(
        whole=np.concatenate([columns, noise[..., None]], axis=2),
        flat=p,
        noise=NoiseStructure(
            placement=groups(segment),
            stance=groups(segment),
            fixed=np.zeros((m, KINDS, KINDS)),
            own=np.tile(np.eye(KINDS), (1, m, 1, 1)),
            shared=nothing,
            owner=np.zeros(0, int),
            free=nothing,
        ),
        information=np.zeros((p, p)),
        sizes=(),
        doubt=np.array([10.0]),
        excess=np.zeros((0, 0)),
        about=np.zeros(0),
        in_time=decorrelated(START),
    )
    return problem, decorrelated


def found_in(problem, decorrelated):
    return likeliest_noise(problem, fit(problem), None, decorrelated, set())


@pytest.mark.parametrize(
    "lasting",
    [NoiseInTime(0.6, 2.0), NoiseInTime(0.95, 2.0), NoiseInTime(0.9, 1.0), NoiseInTime(0.6, 2.0, 0.98)],
)
def test_how_long_noise_lasts_is_found_though_a_fit_takes_its_slow_part(lasting):
    """The likelihood of the residuals alone finds at most half of the duration."""
    found = found_in(*series(np.random.default_rng(402), lasting))
    for one, other in ((found, lasting), (found.of_closure(), lasting.of_closure())):
        assert abs(SHARES.index(one.share) - SHARES.index(other.share)) <= 1
    assert abs(SECONDS.index(found.seconds) - SECONDS.index(lasting.seconds)) <= 1


def test_white_noise_does_not_last():
    rng = np.random.default_rng(403)
    assert all(found_in(*series(rng, WHITE)) == WHITE for _ in range(2))


def test_what_was_far_less_likely_is_not_tried_again():
    problem, decorrelated = series(np.random.default_rng(402), NoiseInTime(0.95, 2.0))
    far, tried = set(), []

    def noted(one):
        tried.append(one)
        return decorrelated(one)

    first = likeliest_noise(problem, fit(problem), None, noted, far)
    assert far <= set(tried)
    tried.clear()
    assert likeliest_noise(problem, fit(problem), first, noted, far) == first
    assert far
    assert not far & set(tried)


def test_the_likelihood_of_noise_that_lasts_is_that_of_the_whole_covariance():
    """Differences of the restricted likelihood, by dense matrices."""
    problem, decorrelated = series(np.random.default_rng(405), START)
    time, columns = STEP * np.arange(ROWS), problem.columns[:ROWS, 0, : SLOW * KINDS : KINDS]
    output = problem.output.reshape(SEGMENTS, ROWS, KINDS)
    used, out, expected = np.ones((len(problem.whole), KINDS), bool), [], []
    for lasting in (START, NoiseInTime(0.5, 1.0)):
        in_time = decorrelated(lasting)
        least = given(replace(problem, in_time=in_time), np.array([2.0]), np.zeros(0)).value
        out.append(in_time.log_volume(used) - least)
        whole = 4 * lasting.correlation(time, WINDOW)
        weighted = np.linalg.solve(whole, columns)
        inner = columns.T @ weighted
        left = np.linalg.inv(whole) - weighted @ np.linalg.solve(inner, weighted.T)
        logs = np.linalg.slogdet(whole)[1] + np.linalg.slogdet(inner)[1]
        expected.append(-0.5 * (SEGMENTS * KINDS * logs + np.einsum("sik,ij,sjk", output, left, output)))
    assert out[0] - out[1] == pytest.approx(expected[0] - expected[1], rel=1e-8)


def test_rows_become_uncorrelated_over_the_rows_that_have_a_residual():
    lasting, rng = NoiseInTime(0.8, 4.0), np.random.default_rng(404)
    time, segment = STEP * np.arange(120), np.repeat(np.arange(3), 40)
    used = np.ones((len(time), 2), bool)
    used[:, 1] = rng.random(len(time)) < 0.7
    each = (lasting, NoiseInTime(0.5, 2.0))
    parts = [(segment, one, [number]) for number, one in enumerate(each)]
    found = decorrelation((time, WINDOW, used), parts)
    unit = np.repeat(np.eye(len(time))[:, None], 2, axis=1)
    for number, (having, one) in enumerate(zip(used.T, each, strict=True)):
        both, whole = np.outer(having, having), (segment[:, None] == segment) * one.correlation(time, WINDOW)
        root = found(unit * having[:, None, None])[:, number]
        assert root @ (both * whole) @ root.T == pytest.approx(np.diag(having.astype(float)), abs=1e-9)
        assert found.back(unit)[:, number] == pytest.approx(found(unit)[:, number].T, abs=1e-12)
        assert found.correlated(unit)[:, number][both] == pytest.approx(whole[both], abs=1e-12)


def test_effective_rows_are_those_of_a_continuous_record():
    """Of a record of L seconds whose noise lasts T, a constant has the information of 1 + L / (2 T) rows."""
    time, segment, lasts = STEP * np.arange(480), np.repeat([1, 2], 240), 8.0
    used = np.ones((480, 2), bool)
    used[::3, 1] = False
    slow = decorrelation((time, WINDOW, used), [(segment, NoiseInTime(1.0, lasts), [0, 1])])
    assert slow.effective_rows == pytest.approx(2 * (1 + 240 * STEP / (2 * lasts)), rel=0.03)
    white = decorrelation((2 * time, WINDOW, used), [(segment, WHITE, [0, 1])])
    assert white.effective_rows == pytest.approx(480)

"""The figures behind the preflight, against MuJoCo, drawing, textbook algebra and counting."""

import dataclasses

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tulip_testbed.identification.center_of_pressure import center_of_pressure
from tulip_testbed.identification.estimators import least_squares
from tulip_testbed.identification.noise_structure import Groups, groups
from tulip_testbed.identification.preflight import preflight
from tulip_testbed.identification.preflight.agreement import fit, shifts
from tulip_testbed.identification.preflight.excitation import predicted_standard_errors
from tulip_testbed.identification.preflight.readings import decimal_step, longest_run, rounding_sd
from tulip_testbed.identification.reading_noise import ReadingNoise, placement_levers, reading_noise
from tulip_testbed.identification.regressor import regression, stacked_regressor
from tulip_testbed.identification.statistics import standard_errors
from tulip_testbed.measurements import SensorSheet


def test_swing_sole_is_where_mujoco_has_it(nominal, model, precise):
    data, adr = mujoco.MjData(model), [model.joint(name).qposadr[0] for name in precise.joints]
    for row in (0, 30, 60):
        data.qpos[adr] = precise.joint_angles[row]
        mujoco.mj_kinematics(model, data)
        right, left = data.body("right_foot"), data.body("left_foot")
        base = right.xmat.reshape(3, 3).T
        turn = base @ left.xmat.reshape(3, 3)
        under = [body.xpos + body.xmat.reshape(3, 3) @ [0, 0, -0.06] for body in (right, left)]
        x, y, z, roll, pitch, yaw = nominal.swing_sole(precise.joint_angles[row : row + 1])[0]
        assert base @ (under[1] - under[0]) == pytest.approx([x, y, z], abs=1e-9)
        quaternion = np.zeros(4)
        mujoco.mju_euler2Quat(quaternion, [yaw, pitch, roll], "zyx")
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, quaternion)
        assert matrix.reshape(3, 3) == pytest.approx(turn, abs=1e-9)


def test_stated_noise_is_what_drawing_it_gives(wii, nominal):
    """Covariance of CoP minus CoM of one posture, cells and encoders drawn 4000 times."""
    measured = wii.measurements
    rng, count = np.random.default_rng(112), 4000
    one = measured.take(np.full(count, 50))
    drawn = dataclasses.replace(
        one,
        cell_forces=one.cell_forces + measured.sensors.cell_sd * rng.standard_normal((count, 8)),
        joint_angles=one.joint_angles + measured.sensors.encoder_sd * rng.standard_normal((count, 12)),
    )
    error = center_of_pressure(drawn) - nominal.center_of_mass(drawn.joint_angles)
    stated = reading_noise(measured.take(np.array([50])), nominal).own[0]
    assert np.cov(error.T) == pytest.approx(stated, rel=0.1, abs=0.05 * stated.max())


def test_placement_levers_are_the_slopes_of_the_cop(wii):
    measured, step = wii.measurements, 1e-6
    levers = placement_levers(measured)
    for k in range(6):
        moved = measured.plate_poses.copy()
        moved[:, k // 3, k % 3] += step
        shift = center_of_pressure(dataclasses.replace(measured, plate_poses=moved)) - center_of_pressure(
            measured
        )
        assert levers[:, :, k] == pytest.approx(shift / step, abs=1e-6)


def dense_covariance(noise: ReadingNoise) -> np.ndarray:
    """Of all residuals, posture by posture, element by element."""
    m = len(noise.own)
    full = np.zeros((m, 2, m, 2))
    for i in range(m):
        full[i, :, i] += noise.own[i]
        for j in range(m):
            if noise.placement[i] == noise.placement[j]:
                full[i, :, j] += noise.shared[i] @ noise.shared[j].T
    return full.reshape(2 * m, 2 * m)


def test_a_shift_is_the_added_column_of_generalised_least_squares(wii, nominal):
    """Against the textbook: theta and shift together by the normal equations."""
    measured = wii.measurements
    noise = reading_noise(measured, nominal)
    data = regression(nominal.parameters, measured, nominal.robot)
    best = fit(measured, data, noise)
    assert best is not None
    weight = np.linalg.inv(dense_covariance(noise))
    # One posture alone; all of a placement, in directions that differ from posture to posture.
    inside = np.flatnonzero(measured.placement == measured.placement[40])
    one, several = np.zeros((2, len(measured), 2, 2))
    one[40] = np.eye(2)
    several[inside] = (1 + np.arange(len(inside)))[:, None, None] * np.eye(2)
    directions = np.tile(np.eye(2), (len(measured), 1, 1))
    singly = shifts(best, directions, Groups(np.arange(len(measured))))
    together = shifts(best, several, groups(measured.placement))
    number = groups(measured.placement).number[40]
    for direction, found, at in ((one, singly, 40), (several, together, number)):
        both = np.hstack([data.matrix, direction.reshape(-1, 2)])
        normal = both.T @ weight @ both
        solved = np.linalg.solve(normal, both.T @ weight @ data.output)
        assert found.size[at] == pytest.approx(solved[-2:], rel=1e-6)
        scale = found.error[at] / np.sqrt(np.diag(np.linalg.inv(normal))[-2:])
        assert scale == pytest.approx([max(1.0, scale[0])] * 2)
        assert 0 < found.p_value[at] < 1
    chi_square = best.square
    residual = data.output - data.matrix @ np.linalg.solve(
        data.matrix.T @ weight @ data.matrix, data.matrix.T @ weight @ data.output
    )
    assert chi_square == pytest.approx(residual @ weight @ residual, rel=1e-6)
    assert noise.variance.ravel() == pytest.approx(np.diag(dense_covariance(noise)))


def test_predicted_standard_errors_are_those_of_the_estimate(wii, precise, nominal):
    """Within what an estimate from 30 placements scatters by; at wii the right plate is taken as no better
    than the left, which errs towards too much."""
    for measured in (wii.measurements, precise):
        data = regression(nominal.parameters, measured, nominal.robot)
        matrix = stacked_regressor(nominal.parameters, measured.joint_angles)
        predicted = predicted_standard_errors(matrix, reading_noise(measured, nominal))
        ratio = predicted / standard_errors(least_squares(data).clustered_covariance)
        assert 0.8 < np.median(ratio) < 1.3
        assert (ratio > 0.6).all()
        assert (ratio < 1.8).all()


@given(
    st.lists(st.integers(-(10**6), 10**6), min_size=1, max_size=20), st.sampled_from([0.1, 0.05, 0.002, 5.0])
)
@settings(max_examples=50, deadline=None)
def test_decimal_step_finds_what_values_were_rounded_to(counts, step):
    values = np.round(np.array(counts) * step, 9)
    coarse = decimal_step(values)
    assert coarse >= step
    assert np.abs(values / coarse - np.round(values / coarse)).max() < 1e-6


def test_rounding_leaves_what_rounding_leaves():
    rng = np.random.default_rng(113)
    for noise in (0.0, 0.1, 0.3):
        at = rng.uniform(size=20_000)
        means = np.mean([np.round(at + noise * rng.standard_normal(at.size)) for _ in range(400)], axis=0)
        extra = np.sqrt(max(np.var(means - at) - noise**2 / 400, 0.0))
        assert rounding_sd(1.0, noise) == pytest.approx(extra, abs=0.01)


def test_a_run_is_as_improbable_as_it_says():
    """Over shuffled orders, a chance below p comes in at most a share p."""
    rng = np.random.default_rng(114)
    values = rng.integers(4, size=40).astype(float)
    chances = []
    for _ in range(2000):
        rng.shuffle(values)
        chances.append(longest_run(values, np.ones(39, dtype=bool))[1])
    for level in (0.01, 0.05, 0.2):
        assert np.mean(np.array(chances) <= level) <= 1.2 * level + 0.002


@given(
    count=st.integers(1, 30),
    scale=st.sampled_from([0.01, 1.0]),  # small enough to pass the check of units, or anything
    angle=st.floats(-3, 3),
    force=st.floats(-300, 300),
    pose=st.floats(-1, 1),
    sd=st.sampled_from([None, 0.0, 1e-4, 1.0]),
    flat=st.booleans(),
    alike=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_no_folder_that_can_be_read_breaks_the_preflight(
    precise, nominal, count, scale, angle, force, pose, sd, flat, alike
):
    part = precise.take(np.zeros(count, dtype=int) if alike else np.arange(count))
    rest = 1e-9 if flat else 1.0
    odd = dataclasses.replace(
        part,
        joint_angles=rest * part.joint_angles + scale * angle,
        cell_forces=part.cell_forces * [rest, 1, 1, 1, 1, 1, 1, 1] + scale * force,
        plate_poses=part.plate_poses + scale * pose,
        sensors=SensorSheet(sd, sd, sd, sd, None if sd is None else (sd, sd, sd)),
    )
    assert len(preflight(odd, nominal)) == 22

"""Simulated records of a humanoid on one foot keep the laws of mechanics and hide what their truth names."""

from dataclasses import replace

import numpy as np
import pytest

import tulip_testbed as tt
from studies.real_robots import records
from studies.real_robots.records import DELAY, _tipping, draw_truth, log, map_text, simulate
from tulip_testbed.calibration.families import Family
from tulip_testbed.calibration.member_removal import members_removed
from tulip_testbed.calibration.reml import fit
from tulip_testbed.calibration.self_calibration import self_calibrate, without_inertia
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance, removed
from tulip_testbed.effects.motion_effects import DAMPING
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.regressor import regression, with_cad_where_needed
from tulip_testbed.identification.residual_channels import by_weight, fields, residuals, sensitivity
from tulip_testbed.sim.robot import joint_names

SECONDS = 8.0
EDGE = slice(100, -100)  # rows away from the ends of a filter


@pytest.fixture(scope="module")
def truth(robot):
    return draw_truth(robot, np.random.default_rng(1))


@pytest.fixture(scope="module")
def motion(robot, truth):
    return simulate(robot, truth, SECONDS, np.random.default_rng(2))


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_true_model_explains_a_body_that_rocks(robot, tmp_path, monkeypatch, side):
    """By MuJoCo's forces: the body turns as its foot rocks, late, and weighs less than stated."""
    exact = (
        ("ENCODER_NOISE", 1e-6),
        ("ENCODER_STEP", 1e-6),
        ("NOISE", (0.0, 0.0)),
        ("STEP_OF", (1e-6, 1e-6)),
    )
    for name, value in exact:
        monkeypatch.setattr(records, name, value)
    plain = draw_truth(robot, None)
    truth = replace(plain, compliance=[0.35 * _tipping(robot)] * 2, mass=dict.fromkeys(plain.mass, 0.7))
    moves = robot
    if side == "right":  # the same motion, mirrored
        moves = replace(robot, stance_foot=robot.swing_foot, swing_foot=robot.stance_foot)
        monkeypatch.setattr(records, "_trajectory", mirrored(robot, records._trajectory))
    told = observed(robot, truth, simulate(moves, truth, SECONDS, np.random.default_rng(2)), tmp_path, side)
    assert set(told.measurements.support) == {side}
    assert told.weighing(-9.0).weighing(0.0).lift == pytest.approx(told.lift, abs=1e-12)
    lighter = told.weighing(-0.3 * told.weight)
    motion = lighter.motion
    prompt = replace(motion, load_rates=motion.load_rates * np.array([1, 1, 0])[:, None, None])
    still = replace(motion, rocking=0 * motion.rocking)
    left = left_unexplained(lighter, truth)
    assert (left < [6e-5, 6e-5, 0.02, 8e-5, 8e-5]).all()  # m, N, rad
    assert (
        left_unexplained(lighter.changed(motion=prompt), truth)[[0, 1, 3, 4]] > 3 * left[[0, 1, 3, 4]]
    ).all()
    assert (
        left_unexplained(lighter.changed(motion=still), truth)[[0, 1, 3, 4]] > 15 * left[[0, 1, 3, 4]]
    ).all()
    assert left_unexplained(told.changed(heavier=lighter.heavier), truth)[2] > 1.2 * left[2]
    unseen = without_inertia(told)
    assert np.abs(unseen.weighing(-9.0).lift).max() < 1e-9 < np.abs(told.lift).max()
    for one in (told, unseen):
        slope = [residuals(one.weighing(h), one.nominal.value)[:, :5] for h in (0.01, -0.01)]
        assert by_weight(one) == pytest.approx((slope[0] - slope[1]) / 0.02, rel=1e-6, abs=1e-9)


def test_evidence_is_that_of_the_readings(robot, tmp_path):
    """Residuals over an estimated weight shrink as it grows: a model with more weight gains nothing by it."""
    plain = draw_truth(robot, None)
    light = replace(plain, mass=dict.fromkeys(plain.mass, 0.9))
    one = observed(robot, light, simulate(robot, light, SECONDS, np.random.default_rng(2)), tmp_path)
    m, nominal = one.measurements, one.nominal
    found = self_calibrate(with_cad_where_needed(one, regression(nominal.parameters, m, robot)))
    ratio = found.mass[0] / robot.model.body_mass.sum()
    assert ratio == pytest.approx(0.9, abs=0.03)
    # Of the centre of pressure and of the direction: how residuals change with the readings.
    rows, cells = np.ix_(range(len(m)), (0, 1, 3, 4)), fields(one)["cells"]
    over = [sensitivity(o, nominal.value)[rows][..., cells] for o in (one, found.observed)]
    volume = [0.5 * float(np.linalg.slogdet(by @ by.mT)[1].sum()) for by in over]
    start = found.solved.scales, found.solved.spreads
    assert found.observed.cad is not None
    left = fit(found.problem, start).log_evidence + found.observed.cad.log_density
    assert found.solved.log_evidence - left == pytest.approx(volume[1] - volume[0], rel=0.02)
    assert volume[1] - volume[0] > 5


def test_a_log_in_axes_that_do_not_lean_becomes_one_in_axes_that_do(robot, tmp_path):
    """What the sensor misread, 5 % of the weight times the lean, is removed in its own axes, which lean."""
    cross_talk = np.eye(6)
    cross_talk[2, 0] = 0.05
    soft = [0.35 * _tipping(robot)] * 2
    exact = replace(
        draw_truth(robot, None), compliance=soft, imu=[0.0, 0.0, 1.0], cross_talk=cross_talk.tolist()
    )
    late, known = tuple(DELAY * np.array(exact.compliance)), catalogue()
    planted = [
        EffectInstance(known["wrench-crosstalk"], "left.fz.fx", (0.05,)),
        EffectInstance(known["foot-compliance"], "left", tuple(exact.compliance)),
        EffectInstance(DAMPING, "left", late),
    ]
    families = [Family(one.effect, 1.0, (one.target,)) for one in planted]
    sizes = np.concatenate([one.values for one in planted])
    motion, left, down = simulate(robot, exact, SECONDS, np.random.default_rng(2)), {}, {}
    for frame in ("sensor", "world"):
        one = observed(robot, replace(exact, frame=frame), motion, tmp_path / frame)
        assert one.upright == (frame == "world")
        left[frame] = left_unexplained(one, exact)[3:]
        theta = one.nominal.value
        by_calibration = members_removed(one, families, sizes, theta, 1e-9 * np.eye(len(theta)))
        down[frame] = [residuals(o, theta)[1:-1, 2] for o in (removed(one, planted), by_calibration)]
    assert left["world"] == pytest.approx(left["sensor"], rel=0.1)
    # The weight times half the square of the lean remains: the sensor's axis is not quite the vertical.
    assert np.array(down["world"]) == pytest.approx(np.array(down["sensor"]), abs=0.03)


def observed(robot, truth, motion, folder, side="left"):
    """Return a motion's log as it is imported; `log` writes that of the left foot."""
    folder.mkdir(exist_ok=True)
    columns = log(robot, truth, motion, np.random.default_rng(3))
    if side == "right":
        columns = {exchanged(name) if "_foot_" in name else name: one for name, one in columns.items()}
    table, names = np.column_stack(list(columns.values())), ",".join(columns)
    np.savetxt(folder / "a.csv", table, "%.6f", ",", header=names, comments="")
    (folder / "map.toml").write_text(map_text(robot, truth))
    tt.import_table(folder / "a.csv", robot, out=folder / "rows", map=[str(folder / "map.toml")])
    m = tt.read_measurements(folder / "rows")
    return observe(m, nominal_robot(robot, common_support(m.support)))


def exchanged(name):
    """Return a name of the other side."""
    side, _, rest = name.partition("_")
    return f"{'right' if side == 'left' else 'left'}_{rest}"


def mirrored(robot, trajectory):
    """Return `trajectory` with the joints of both legs exchanged: roll and yaw turn the other way."""
    names = joint_names(robot.model)
    others = [names.index(exchanged(name)) for name in names]
    signs = np.array([1.0 if robot.model.joint(name).axis[1] else -1.0 for name in names])

    def made(_, *args):
        aim = trajectory(robot, *args)
        return lambda *at: signs * aim(*at)[others]

    return made


def left_unexplained(observed, truth):
    """Return the s.d. of centre of pressure, vertical force and its direction by the truth, (5,)."""
    side = str(observed.measurements.support[0])
    late = DAMPING.remove(observed, side, tuple(DELAY * np.array(truth.compliance)))
    clean = catalogue()["foot-compliance"].remove(late, side, tuple(truth.compliance))
    return residuals(clean, observed.nominal.value)[1:-1, :5].std(axis=0)


@pytest.mark.slow
def test_wrenches_in_axes_that_turn_become_the_same_rows(robot, truth, motion, tmp_path):
    rows = []
    for frame, sign in (("sensor", 1), ("base", -1)):
        told = observed(robot, replace(truth, frame=frame, sign=sign), motion, tmp_path / frame)
        rows.append(told.measurements.wrenches)
        checks = tt.check(tmp_path / frame / "rows", robot).checks
        audited = next(one for one in checks if one.name == "conventions")
        had = "the log had axes of the wrench: base link, sign of the wrench: of the robot on the ground"
        assert (had in audited.seen) == (frame == "base")
    assert rows[1] == pytest.approx(rows[0], abs=0.002)

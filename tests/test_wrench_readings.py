"""Six-axis and smaller sensors in the ankles, in the soles and on the ground, in both engines.

Their readings are compared with cells, with MuJoCo's contact forces and weights, and with the data sheet.
"""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tulip_testbed as tt
from tests.edited_rows import within
from tests.first_look import cases
from tests.statics_against_dynamics import center_of_pressure, compare, laboratories
from tulip_testbed.discovery.candidates import candidates
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.instance import removed
from tulip_testbed.experiments.identify import identify
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import residuals
from tulip_testbed.measurements.contacts import WRENCH
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.dynamics.hold import hold, put_down
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.sensors import PRESETS
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

NAMES = ("foot-ft", "plate-ft", "plate-cop", "sole-ft", "sole-3axis")
WHOLE = ("foot-ft", "plate-ft", "sole-ft")  # of six axes
GRAVITY = 9.81
TILTED = {  # m, rad: mountings
    "foot-ft": (0.01, -0.02, 0.03, 0.2, -0.3, 0.4),
    "plate-ft": (0.0,) * 6,
    "sole-ft": (0.01, -0.02, 0.03, 0.0, 0.0, 0.4),
}


def changed_rig(robot: tt.Robot, name: str, exact: bool = True, **changes: Any) -> Rig:
    """Return a preset's laboratory with changed wrench sensors, in which nothing is measured twice.

    Args:
        exact: encoders and records are exact, and wrench sensors err by their zeros alone.
    """
    rig = preset_rig(name, robot)
    wrench: Any = PRESETS[name].wrench
    base = PRESETS["ideal"] if exact else rig.sensors
    wrench = replace(wrench.exact if exact else wrench, **changes)
    protocol = replace(rig.protocol, repeats=0)
    return replace(rig, sensors=replace(base, wrench=wrench), protocol=protocol)


def laboratory(robot: tt.Robot, name: str) -> tt.Laboratory:
    return tt.Laboratory(robot, name, nominal=changed_rig(robot, name))


def heavy_foot(spec: mujoco.MjSpec) -> None:
    """Make the left foot 0.3 kg heavier and move its centre of mass."""
    foot = spec.body("left_foot")
    foot.mass, foot.ipos = foot.mass + 0.3, [0.05, 0.01, -0.04]


def feet_in_base(robot: tt.Robot, measured: Any) -> np.ndarray:
    """Return the feet's frames by row and side from MuJoCo's kinematics, (m, 2, 4, 4)."""
    data, chain = mujoco.MjData(robot.model), ClosedChain(robot.model, robot)
    frames = np.tile(np.eye(4), (len(measured), 2, 1, 1))
    for row, angles in enumerate(measured.joint_angles):
        data.qpos[:7] = chain.base_pose(angles, int(measured.support[row] == "left"))
        data.qpos[7:] = angles
        mujoco.mj_kinematics(robot.model, data)
        for side, foot in enumerate(robot.feet):
            frames[row, side, :3, :3] = data.body(foot).xmat.reshape(3, 3)
            frames[row, side, :3, 3] = data.body(foot).xpos
    return frames


def sensors_in_base(robot: tt.Robot, measured: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation (m, 2, 3, 3) and origin (m, 2, 3) of the sensors' frames in the base frame.

    On the ground by the recorded pose of the plate, its top at height zero; in the foot by MuJoCo.
    """
    if measured.contacts.mount == "foot":
        frames = feet_in_base(robot, measured)
        turn = frames[..., :3, :3]
        return turn, frames[..., :3, 3] + np.einsum("mpab,pb->mpa", turn, measured.contacts.pose[:, :3])
    x, y, yaw = np.moveaxis(measured.plate_poses, -1, 0)
    zero, one = np.zeros_like(x), np.ones_like(x)
    rows = [[np.cos(yaw), -np.sin(yaw), zero], [np.sin(yaw), np.cos(yaw), zero], [zero, zero, one]]
    return np.moveaxis(np.array(rows), (0, 1), (2, 3)), np.stack([x, y, zero], axis=-1)


def ground_wrenches(robot: tt.Robot, run: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return forces and moments of the ground about the base frame's origin, (m, 2, 3) twice [N, Nm].

    Zeros and what hangs below the sensor are taken off. Channels that are not read are zero.
    """
    measured = run.measurements
    turn, origin = sensors_in_base(robot, measured)
    wrench = np.zeros((len(measured), 2, 6))
    kept = [WRENCH.index(channel) for channel in measured.contacts.channels]
    wrench[..., kept] = np.nan_to_num(measured.wrenches - run.truth.zeros)  # nan: in the air
    force = np.einsum("mpab,mpb->mpa", turn, wrench[..., :3])
    moment = np.einsum("mpab,mpb->mpa", turn, wrench[..., 3:]) + np.cross(origin, force)
    if measured.contacts.below.any():
        feet = feet_in_base(robot, measured)
        mass, center = measured.contacts.below[:, 0], measured.contacts.below[:, 1:]
        weight = np.multiply.outer(-mass * GRAVITY, [0.0, 0.0, 1.0])
        place = feet[..., :3, 3] + np.einsum("mpab,pb->mpa", feet[..., :3, :3], center)
        force, moment = force - weight, moment - np.cross(place, np.broadcast_to(weight, place.shape))
    return force, moment


@pytest.fixture(scope="module")
def mixed_few() -> Any:
    """Both feet and each foot alone, 28 postures."""
    plan = tt.plans.mixed
    return plan.take(np.isin(plan.placement, np.unique(plan.placement)[::4]))


@pytest.fixture(scope="module")
def static(robot, mixed_few) -> dict[str, Any]:
    """The same equilibria by four ideal cells and by every exact sensor."""
    runs: dict[str, Any] = {name: laboratory(robot, name).run(mixed_few, 3, "statics") for name in NAMES}
    rig = preset_rig("ideal", robot)
    cells = replace(rig, protocol=replace(rig.protocol, repeats=0))
    return runs | {"ideal": tt.Laboratory(robot, nominal=cells).run(mixed_few, 3, "statics")}


@pytest.mark.parametrize("name", NAMES)
def test_every_sensor_says_what_four_ideal_cells_say(static, robot, name):
    cells, run = static["ideal"].measurements, static[name]
    assert np.array_equal(run.measurements.joint_angles, cells.joint_angles)
    assert set(cells.support) == {"double", "right", "left"}
    force, moment = (part.sum(axis=1) for part in ground_wrenches(robot, run))
    pressure = np.column_stack([-moment[:, 1], moment[:, 0]]) / force[:, 2:]
    total = cells.cell_forces.sum(axis=1)
    center = center_of_pressure(cells.cells, cells.plate_poses, cells.cell_forces)
    # A foot is tilted by microradians, so that a little of the horizontal force is in the vertical one.
    loose = {"sole-3axis": 1e-4, "foot-ft": 2e-3}.get(name, 1e-6)
    np.testing.assert_allclose(force[:, 2], total, rtol=0, atol=loose)
    np.testing.assert_allclose(pressure, center, rtol=0, atol=2e-5 if name == "foot-ft" else 1e-6)


def test_on_one_foot_a_gain_is_no_candidate_where_nobody_knows_the_weight(static, robot):
    """Both scale the vertical force. Two feet distinguish them, since each has a gain of its own."""
    measured = static["foot-ft"].measurements
    for support, weighed, searched in (
        ("right", None, False),
        ("right", (20.0, 0.01), True),
        ("double", None, True),
    ):
        some = replace(measured.take(measured.support == support), weighed_mass=weighed)
        every = candidates(observe(some, nominal_robot(robot, "right")))
        assert any(one.effect.name == "wrench-gain" for one in every) == searched
        assert any(one.target.endswith(".fz.fz") for one in every) == searched


@pytest.mark.parametrize("name", WHOLE)
def test_a_foot_in_the_air_reads_its_zero_minus_its_weight(static, robot, name):
    """Of which a plate, which is tared, and a sole have nothing."""
    m, zeros = static[name].measurements, static[name].truth.zeros
    feet = feet_in_base(robot, m)[..., :3, :3]
    for side, support in enumerate(("left", "right")):
        foot, hanging = robot.model.body(robot.feet[side]), np.flatnonzero(m.support == support)
        assert len(hanging) >= 5
        weight = feet[hanging, side].mT @ [0.0, 0.0, -foot.mass[0] * GRAVITY * (name == "foot-ft")]
        expected = zeros[side] + np.hstack([weight, np.cross(foot.ipos, weight)])
        np.testing.assert_allclose(
            m.wrenches[hanging, side], expected, atol=2e-3 * (name == "foot-ft") + 1e-9
        )
        assert name != "foot-ft" or np.abs(weight[:, 0]).max() > 0.1  # N, tilted
    assert zeros.any() == (name != "plate-ft")


@pytest.mark.parametrize("name", WHOLE)
@pytest.mark.parametrize("sticks", [False, True])
def test_the_dynamics_sum_up_mujocos_contacts(robot, plan, name, sticks):
    """Each contact's force by `mj_contactForce`, what dry friction holds, and the weight below the sensor."""
    rig = edited(changed_rig(robot, name, mounting=TILTED[name]), heavy_foot)
    stand = Stand(rig, boards_under(rig, plan.foot_poses[:1])[0] + [0.004, -0.006, 0.02])
    put_down(stand, plan.joint_angles[0])
    held, reason = hold(stand, plan.joint_angles[0])
    assert held is not None, reason
    model, data = stand.model, stand.data
    if not sticks:
        stand.stiction.release(data)
        stand.run(1.0)
    assert data.xfrc_applied.any() == sticks
    mujoco.mj_forward(model, data)
    mounted = Rotation.from_euler("xyz", TILTED[name][3:]).as_matrix()
    for side, (foot, plate) in enumerate(zip(robot.feet, ("right_plate", "left_plate"), strict=True)):
        body, own = data.body(plate if name == "plate-ft" else foot), model.body(foot).id
        geom = robot.model.geom(f"{foot}_front_left")
        height = {"plate-ft": 0.05, "sole-ft": geom.pos[2] - geom.size[0]}.get(name, 0.0)
        turn = body.xmat.reshape(3, 3)
        origin = body.xpos + turn @ np.add(TILTED[name][:3], [0, 0, height])
        force, moment = np.zeros(3), np.zeros(3)
        for k, contact in enumerate(data.contact):
            bodies = model.geom_bodyid[[contact.geom1, contact.geom2]].tolist()
            if own not in bodies:
                continue
            local = np.zeros(6)
            mujoco.mj_contactForce(model, data, k, local)
            # The force is that of the first geom on the second one, along the frame's rows.
            push = contact.frame.reshape(3, 3).T @ local[:3] * (1 if bodies[1] == own else -1)
            force += push
            moment += np.cross(contact.pos - origin, push)
        assert force[2] > 50  # N, up: of the ground on the foot
        weight = [0.0, 0.0, -model.body_mass[own] * GRAVITY * (name == "foot-ft")]
        for push in (data.xfrc_applied[own, :3], weight):
            force += push
            moment += np.cross(data.xipos[own] - origin, push)
        moment += data.xfrc_applied[own, 3:]
        axes = turn @ mounted
        expected = np.concatenate([axes.T @ force, axes.T @ moment])
        np.testing.assert_allclose(stand.wrenches()[side], expected, atol=2e-3 if name == "foot-ft" else 1e-6)


QUICK = [("foot-ft", "heavy foot")]
SLOW = [
    ("plate-ft", "soft soles"),
    *(("foot-ft", kind) for kind in ("as it is", "soft soles", "flexible drives", "pulled by ropes")),
]
SLOW += [("plate-ft", "as it is"), ("sole-ft", "as it is"), ("sole-ft", "soft soles")]


@cases("name, kind", QUICK, SLOW)
def test_statics_reads_what_the_dynamics_read(robot, plan, name, kind):
    """Every channel, for sensors that are mounted askew, without the joints' dry friction."""
    rigs = laboratories(changed_rig(robot, name, mounting=TILTED[name]))
    rig = rigs[kind] if kind in rigs else edited(rigs["as it is"], heavy_foot)
    few = plan.take(np.arange(5, 8))
    found = compare(solve_plan(rig, few), list(run_dynamics(rig, few, 1).truth.attempts))
    assert len(found.held) == 3
    assert np.abs(found.wrenches[..., :3]).max() < 0.02  # N
    assert np.abs(found.wrenches[..., 3:]).max() < 0.004  # Nm


@pytest.mark.parametrize("name", NAMES)
def test_readings_scatter_as_the_data_sheet_says_about_constant_zeros(robot, mixed_few, name):
    plan = solve_plan(changed_rig(robot, name, exact=False), mixed_few.take(np.arange(8)))
    runs: list[Any] = list(run_statics(plan, np.random.SeedSequence(7).spawn(60)))
    contacts = runs[0].measurements.contacts
    assert contacts.mount == ("ground" if name.startswith("plate") else "foot")
    kept = [WRENCH.index(channel) for channel in contacts.channels]
    read = np.concatenate([run.measurements.wrenches for run in runs])
    true = np.concatenate([run.truth.wrenches[..., kept] for run in runs])
    zeros = np.array([run.truth.zeros for run in runs])
    if name == "plate-cop":
        read, true = (
            np.stack([-w[..., 2] / w[..., 0], w[..., 1] / w[..., 0], w[..., 0]], axis=-1)
            for w in (read, np.where(np.isnan(read), np.nan, true))
        )
        stated = contacts.cop_sd[0]
    else:
        true = true + np.repeat(zeros, [len(run.measurements) for run in runs], axis=0)
        stated = np.sqrt(np.diag(contacts.covariance))
    found, count = np.sqrt(np.nanmean((read - true) ** 2, axis=(0, 1))), np.isfinite(read[..., 0]).sum()
    np.testing.assert_allclose(found / stated, 1, atol=5 / np.sqrt(2 * count))
    assert contacts.below.any() == (name == "foot-ft")
    sheet: Any = PRESETS[name].wrench
    if contacts.mount == "ground":
        assert not contacts.zero_sd.any()
        assert runs[0].measurements.sensors.placement_sd == PRESETS[name].placement_sd
    else:
        spread = np.sqrt((zeros**2).mean(axis=(0, 1))) / np.array(sheet.zero_sd)
        np.testing.assert_allclose(spread, 1, atol=5 / np.sqrt(240))


def test_a_sensor_that_was_never_in_the_air_is_as_far_off_as_the_one_that_was(static, robot):
    """The s.d. of its zeros is right over sensors that are tared well or badly, both alike."""
    run, rng = static["sole-ft"], np.random.default_rng(5)
    m = run.measurements.take(np.flatnonzero(run.measurements.support == "left"))
    exact, nominal, shares = m.wrenches - run.truth.zeros, nominal_robot(robot, "left"), []

    def left_sd(measurements: tt.Measurements) -> np.ndarray:
        sd = observe(measurements, nominal).contacts.zero_sd
        assert sd is not None
        return sd[1]

    for tared in rng.uniform(0.3, 3.0, 300):
        zeros = tared * rng.standard_normal((2, 6)) * ([1.0] * 3 + [0.03] * 3)
        shares.append(zeros[1] / left_sd(replace(m, wrenches=exact + zeros)))
    assert np.sqrt(np.square(shares).mean()) == pytest.approx(1.0, abs=0.12)
    assert (left_sd(within("contacts", m, zero_sd=np.full((2, 6), 2.0))) == 2.0).all()
    wrenches = exact.copy()
    wrenches[:, 0] = 0.0  # written by a program that leaves out a foot in the air
    assert (left_sd(replace(m, wrenches=wrenches)) > 10.0).all()  # N, Nm: nothing is known
    plates = static["plate-ft"].measurements  # whose moments have another range
    plates = within("contacts", plates, zero_sd=np.full((2, 6), np.inf))
    plates = plates.take(np.flatnonzero(plates.support == "left"))
    assert (left_sd(replace(plates, wrenches=plates.wrenches + 0.1)) > 10.0).all()


@pytest.mark.parametrize(("name", "seed"), [("foot-ft", 5), ("sole-3axis", 6)])
def test_a_weight_that_nothing_shows_is_cads(robot, plan, name, seed):
    """Moments over an unknown weight are base parameters of any size: estimates wandered 4 to 8 s.e. off."""
    run = tt.Laboratory(robot, name, random_robot=(0.1, seed)).run(plan, seed, "statics")
    found = tt.identify(replace(run.measurements, weighed_mass=None), robot)
    assert abs(found.mass[0] - run.truth.mass) < 3 * found.mass[1] < 0.1 * run.truth.mass
    off = found.full.value - found.parameters.values(run.truth.standard)
    assert off @ np.linalg.solve(found.full.covariance, off) < 2 * len(off)


def test_measurements_say_what_a_user_knows_and_no_more(robot, plan, static):
    dynamic: Any = run_dynamics(changed_rig(robot, "foot-ft"), plan.take(plan.placement <= 1), 7)
    for run in (dynamic, static["foot-ft"]):
        m, zeros = run.measurements, run.truth.zeros
        assert np.abs(zeros).min() > 0
        assert (m.contacts.mount, m.contacts.channels) == ("foot", WRENCH)
        assert np.isposinf(m.contacts.zero_sd).all()
        np.testing.assert_allclose(m.contacts.below, [[0.6, 0.03, 0, -0.035]] * 2, atol=1e-12)
        assert m.sensors.cell_sd is m.sensors.cell_resolution is m.sensors.placement_sd is None
        parts = [*vars(m).values(), *vars(m.contacts).values()]
        arrays = [part for part in parts if isinstance(part, np.ndarray) and part.dtype.kind == "f"]
        assert not any(np.isin(np.abs(part), np.abs(zeros)).any() for part in arrays)


def test_the_sensors_do_not_change_how_the_robot_stands(robot, plan):
    one = plan.take(np.arange(1))
    plates, feet = (run_dynamics(preset_rig(name, robot), one, 5).truth for name in ("ideal", "foot-ideal"))
    assert plates.wrenches is plates.zeros is None
    assert np.array_equal(plates.held[0].cell_forces, feet.held[0].cell_forces)
    assert np.array_equal(plates.held[0].joint_angles, feet.held[0].joint_angles)


# Directions that zeros hide on both feet alone, and a bound [m].
EXACT = [("plate-ft", 0, 1e-4), ("plate-cop", 0, 1e-4), ("sole-ft", 5, 1e-3)]


@cases("name, hidden, bound", EXACT, [("sole-3axis", 5, 1e-3)])
def test_exact_sensors_recover_all_that_their_zeros_leave(robot, name, hidden, bound):
    """On both feet alone the same five directions are hidden as in the ankles; on the mixed plan none."""
    for plan, count in ((tt.plans.random, hidden), (tt.plans.mixed, 0))[: 1 + (hidden > 0)]:
        run = laboratory(robot, name).run(plan, 5, "statics")
        found = identify(run.measurements, robot)
        assert len(found.confounded) == count
        along = np.linalg.qr(found.confounded.T)[0] if count else np.zeros((len(found.full.value), 0))
        error = found.full.value - run.laboratory.true_base_parameters(plan)
        assert np.abs(error - along @ (along.T @ error)).max() < bound


@pytest.mark.parametrize("name", ["plate-ft", "plate-cop", "sole-ft"])
@pytest.mark.parametrize("effect", ["tilt=0.02,0.03", "tether=5,2"])
def test_a_push_is_removed_at_the_height_of_the_readings(robot, mixed_few, name, effect):
    """A plate's wrench is stated at its top, 50 mm over the floor on which cells stand."""
    few = mixed_few.take(mixed_few.support == "double")
    pushed_lab, nominal = laboratory(robot, name).with_effects(effect), nominal_robot(robot)
    pushed = observe(pushed_lab.run(few, 3, "statics").measurements, nominal)
    plain = observe(laboratory(robot, name).run(few, 3, "statics").measurements, nominal)
    means = [
        residuals(observed, nominal.value)[:, :2].mean(axis=0)
        for observed in (removed(pushed, list(pushed_lab.hidden)), plain)
    ]
    assert np.abs(means[0] - means[1]).max() < 2e-4

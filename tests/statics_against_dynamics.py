"""Compare static equilibria with the full dynamics, in laboratories that differ from the usual one."""

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.sim.compliance import Compliance
from tulip_testbed.sim.drives import Drives
from tulip_testbed.sim.outcome import Attempt
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.statics.forces import Load, StaticState, sole_poses
from tulip_testbed.sim.statics.sensed_wrenches import sensed_wrenches
from tulip_testbed.sim.statics.solve import cell_forces, solve_by_newton
from tulip_testbed.sim.statics.solved_plan import SolvedPlan, feet_in_base
from tulip_testbed.sim.statics.static_run import Tries, solve_tries

Edit = Callable[[mujoco.MjSpec], None]


@dataclass(frozen=True)
class Comparison:
    """Statics minus dynamics for each posture that the dynamics held.

    Attributes:
        held: the postures in the dynamics. angles: differences, (m, n_joints) [rad].
        cells: differences, (m, 8) [N]. center: distance of the centres of pressure, (m,) [m].
        wrenches: differences of the foot sensors, (m, 2, 6) [N, Nm]; without such sensors (m, 0, 6).
    """

    held: list[Attempt]
    angles: np.ndarray
    cells: np.ndarray
    center: np.ndarray
    wrenches: np.ndarray


def without_friction(*edits: Edit) -> Edit:
    """Return an edit that removes the dry friction of all joints and makes other edits."""

    def edit(spec: mujoco.MjSpec) -> None:
        for joint in spec.joints:
            joint.frictionloss = 0.0
        for other in edits:
            other(spec)

    return edit


def tilted(spec: mujoco.MjSpec) -> None:
    """Tilt gravity by 2 degrees."""
    spec.option.gravity = 9.81 * np.array([np.sin(0.035), 0.0, -np.cos(0.035)])


def heavier(spec: mujoco.MjSpec) -> None:
    """Make the torso 1 kg heavier and move its centre of mass 30 mm forward."""
    torso = spec.body("torso")
    torso.mass, torso.ipos = torso.mass + 1.0, [torso.ipos[0] + 0.03, 0.01, torso.ipos[2]]


def longer(spec: mujoco.MjSpec) -> None:
    """Make the left lower leg 1 mm longer."""
    spec.body("left_ankle").pos = [0, 0, spec.body("left_ankle").pos[2] - 0.001]


def pulled(spec: mujoco.MjSpec) -> None:
    """Pull at the torso by a spring from the side and by a weight over a pulley from the front."""
    for name, anchor, stiffness, length in (
        ("spring", [0.0, 2.0, 1.0], 20.0, 1.9),
        ("weight", [200.0, 0.0, 1.0], 5.0 / 200, 0.0),
    ):
        spec.worldbody.add_site(name=f"{name}_anchor", pos=anchor)
        spec.body("torso").add_site(name=f"{name}_hook", pos=[0, 0, 0.3])
        tendon = spec.add_tendon(name=name, stiffness=stiffness, springlength=[0.0, length])
        tendon.wrap_site(f"{name}_anchor")
        tendon.wrap_site(f"{name}_hook")


def short_foot(spec: mujoco.MjSpec) -> None:
    """Shorten the foot of the right board at its front left cell by 0.3 mm."""
    cell = spec.geom("right_plate_front_left")
    cell.pos = cell.pos + np.array([0.0, 0.0, 3e-4])


def stopped(spec: mujoco.MjSpec) -> None:
    """Let the left knee lean on a soft stop of its own shape, which acts 0.01 rad before its end."""
    knee = spec.joint("left_knee")
    knee.range, knee.margin = [0.0, 60.0 if spec.compiler.degree else np.radians(60.0)], 0.01
    knee.solref_limit, knee.solimp_limit = [0.0005, 3.0], [0.1, 0.6, 0.05, 0.3, 3.0]


def laboratories(rig: Rig) -> dict[str, Rig]:
    """Return the laboratories in which statics and dynamics are compared, all without dry friction."""
    plain = dataclasses.replace(rig, edit=without_friction())
    rigs = {"as it is": plain}
    for name, edit in (
        ("gravity 2 deg off", tilted),
        ("torso 1 kg heavier", heavier),
        ("shank 1 mm longer", longer),
        ("pulled by ropes", pulled),
        ("board rocks", short_foot),
        ("a knee at its stop", stopped),
    ):
        rigs[name] = dataclasses.replace(rig, edit=without_friction(edit))
    rigs["flexible drives"] = dataclasses.replace(plain, drives=Drives(wind_up=0.01))
    rigs["soft soles"] = dataclasses.replace(plain, compliance=Compliance(sole=2e-6, sole_tilt=2e-4))
    rigs["soft cells"] = dataclasses.replace(plain, compliance=Compliance(cell=2e-6))
    return rigs


def compare(solved_plan: SolvedPlan, attempts: list[Attempt]) -> Comparison:
    """Solve the postures that the dynamics held, given their commands and the places of feet and plates."""
    m, plan = solved_plan.mechanism, solved_plan.plan
    held = [a for a in attempts if a.held is not None]
    rows = planned_rows(solved_plan, held)
    angles = np.array([a.held.joint_angles for a in held if a.held])
    command = np.array([a.held.commanded for a in held if a.held])
    near = solved_plan.reference.state
    start = StaticState(near.position[rows], near.rotation[rows], near.angles[rows], near.wrench[rows])
    load = Load(
        command=command,
        friction=np.zeros(len(m.names)),
        feet=standing(solved_plan, rows, angles),
        plates=np.array([a.true_plates for a in held]),
        mass=m.mass,
        center=m.center,
        foot_contact=feet_in_contact(plan.support)[rows],
    )
    solved = solve_by_newton(m, start, load)
    forces = cell_forces(m, solved.state, load)
    actual = np.array([a.held.cell_forces for a in held if a.held])
    centers = [center_of_pressure(m.cells, load.plates, f) for f in (forces, actual)]
    return Comparison(
        held,
        solved.state.angles[:, m.joints] - angles,
        forces - actual,
        np.linalg.norm(centers[0] - centers[1], axis=1),
        sensed_wrenches(solved_plan, solved.state, load)
        - np.array([a.held.wrenches for a in held if a.held]),
    )


def planned_rows(solved_plan: SolvedPlan, held: list[Attempt]) -> np.ndarray:
    """Return the row of the plan of each held posture, (m,)."""
    row = {int(number): k for k, number in enumerate(solved_plan.plan.posture)}
    return np.array([row[a.posture] for a in held])


def standing(solved_plan: SolvedPlan, rows: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the planar poses of both feet in the base frame at the held angles, (m, 2, 3) [m, m, rad].

    A compliant sole tilts against its foot; its pose is that of the solved plan.
    """
    m, near = solved_plan.mechanism, solved_plan.reference.state
    coordinates = near.angles[rows].copy()
    coordinates[:, m.joints] = angles
    poses = sole_poses(
        m, StaticState(near.position[rows], near.rotation[rows], coordinates, near.wrench[rows])
    )
    return feet_in_base(poses, solved_plan.plan.support[rows])


def center_of_pressure(cells: np.ndarray, plates: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Compute the centre of pressure from all eight cells, (m, 2) [m]."""
    sides = forces.reshape(-1, 2, 4)
    share = sides.sum(axis=2) / forces.sum(axis=1)[:, None]
    centers = [plate_center(cells[k], plates[:, k], sides[:, k]) for k in (0, 1)]
    return share[:, :1] * centers[0] + share[:, 1:] * centers[1]


def plate_center(cells: np.ndarray, plate: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """Compute the centre of pressure on one plate in the base frame, (m, 2) [m]."""
    own = forces @ cells / np.maximum(forces.sum(axis=1), 1e-9)[:, None]  # of an empty plate: its middle
    c, s = np.cos(plate[:, 2]), np.sin(plate[:, 2])
    return plate[:, :2] + np.column_stack([c * own[:, 0] - s * own[:, 1], s * own[:, 0] + c * own[:, 1]])


def excess_sag(
    solved_plan: SolvedPlan, held: list[Attempt], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Compute by how much dry friction changes each joint's angle [rad] and, last column, the load share.

    Returns:
        the changes in the held postures, (m, n_joints + 1), and those that statics draws,
        (5 m, n_joints + 1).
    """
    m = solved_plan.mechanism
    found = compare(without(solved_plan), held)
    forces = np.array([a.held.cell_forces for a in held if a.held])
    actual = np.column_stack([-found.angles, load_share(forces) - load_share(forces + found.cells)])
    drawn = []
    for still, loose, loads in _drawn(solved_plan, held, rng):
        shares = [load_share(cell_forces(m, state, loads)) for state in (still, loose)]
        drawn.append(np.column_stack([(still.angles - loose.angles)[:, m.joints], shares[0] - shares[1]]))
    return actual, np.concatenate(drawn)


def _drawn(
    solved_plan: SolvedPlan, held: list[Attempt], rng: np.random.Generator
) -> Iterator[tuple[StaticState, StaticState, Load]]:
    """Draw the held postures in statics: with dry friction, without it, and their loads."""
    free = without(solved_plan)
    rows = planned_rows(solved_plan, held)
    place = np.array([a.placement for a in held])
    fresh = np.append(True, place[1:] != place[:-1])
    before = np.where(fresh, rows, np.append(0, rows[:-1]))
    m = solved_plan.mechanism
    for _ in range(5):
        tries = Tries(
            run=np.zeros(len(rows), int),
            row=rows,
            before=before,
            fresh=fresh,
            command=np.array([a.held.commanded for a in held if a.held]),
            offset=solved_plan.plan.feed_forward[rows] / m.gain,
            push=rng.standard_normal((len(rows), 2)),
            scatter=rng.standard_normal((len(rows), len(m.names))),
            plates=np.array([a.true_plates for a in held]),
        )
        (still, loads, _), (loose, _, _) = (
            solve_tries(p, tries, m.mass, m.center) for p in (solved_plan, free)
        )
        yield still, loose, loads


def without(solved_plan: SolvedPlan) -> SolvedPlan:
    """Return the same laboratory without dry friction."""
    m = solved_plan.mechanism
    return dataclasses.replace(solved_plan, mechanism=dataclasses.replace(m, friction=0 * m.friction))


def load_share(forces: np.ndarray) -> np.ndarray:
    """Return the share of the weight on the right plate, (m,)."""
    return forces[:, :4].sum(axis=1) / forces.sum(axis=1)

"""The whole experiment by static equilibrium: what `sim.laboratory` hands over, a thousand times as fast.

Plates are laid, postures commanded, tracked with error, read and recorded as there; only the
robot's motion is left out. docs/equilibrium.md says what that misses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from sim.equilibrium import (
    Load,
    Mechanism,
    Reference,
    State,
    cell_forces,
    faults,
    left_friction,
    mechanism,
    reference,
    soles,
    solve,
    swaying,
    ways,
)
from sim.errors import InputError
from sim.laboratory import boards_under
from sim.measurements import Measurements, PosturePlan
from sim.model import load_model
from sim.path import ClosedChain
from sim.record import (
    check_support,
    choose_repeats,
    constants,
    new_set_up,
    order_of_tries,
    record,
    record_error,
    stage_at,
    start_times,
    weigh,
)
from sim.rig import Rig, stages
from sim.sensors import read_cells, read_encoders, sample_mean

NO_EQUILIBRIUM = "tipped"


@dataclass(frozen=True)
class Prepared:
    """A laboratory and a plan, with all that does not change between runs.

    Attributes:
        near: every posture solved as planned, batch (postures,).
        boards: where the boards are to lie, by placement, (placements, 2, 3).
        placement: index of every posture's placement, (postures,).
        links: the robot's bodies as numbers of the mechanism's, in MJCF order, (n_links,).
        fixed: see `sim.record.constants`.
        later: the same of what stands there later, by the part of the experiment's time.
    """

    rig: Rig
    plan: PosturePlan
    mechanism: Mechanism
    near: Reference
    boards: np.ndarray
    placement: np.ndarray
    links: np.ndarray
    fixed: dict[str, Any]
    later: tuple[tuple[float, Prepared], ...] = ()


@dataclass(frozen=True)
class Tries:
    """What is tried in some runs, all of them after one another, b tries in all.

    Attributes:
        run, row: number of the run and row of the plan, (b,).
        before: row of the plan from which the robot moves, (b,).
        fresh: whether it is put down instead, (b,) bool.
        command: commanded angles, (b, n_joints). offset: of it, by feed-forward torques, (b, n_joints).
        push, scatter: standard normal, of swaying and of dry friction, (b, 2) and (b, n).
        plates: true poses, (b, 2, 3).
    """

    run: np.ndarray
    row: np.ndarray
    before: np.ndarray
    fresh: np.ndarray
    command: np.ndarray
    offset: np.ndarray
    push: np.ndarray
    scatter: np.ndarray
    plates: np.ndarray


@dataclass(frozen=True)
class Outcome:
    """What some tries came to.

    Attributes:
        joints, motors: angles, (b, n_joints) [rad]. forces: of the cells, (b, 8) [N].
        reason: why a try cannot be used, or "", (b,) of text.
    """

    joints: np.ndarray
    motors: np.ndarray
    forces: np.ndarray
    reason: np.ndarray


@dataclass(frozen=True)
class StaticRun:
    """One run: what it hands over and, apart from it, the truth.

    Attributes:
        measurements: the data contract.
        dropped: number of every posture of which no try could be used, and why its first could not.
        standard: standard parameters of the robot that stood there (eq. 5), (n_links, 4) [kg, kg m].
    """

    measurements: Measurements
    dropped: tuple[tuple[int, str], ...]
    standard: np.ndarray

    @property
    def true_mass(self) -> float:
        """[kg]"""
        return float(self.standard[:, 0].sum())


def prepare(rig: Rig, plan: PosturePlan) -> Prepared:
    """Solve every posture of a plan once, as planned.

    Raises:
        InputError: a support other than double, or a scene that this statics does not know.
    """
    first, *others = stages(rig)
    later = tuple((start, _prepare(one, plan)) for start, one in others)
    return replace(_prepare(first[1], plan), rig=rig, later=later)


def _prepare(rig: Rig, plan: PosturePlan) -> Prepared:
    check_support(plan)
    m, model = mechanism(rig), load_model(rig.robot)
    placements, placement = np.unique(plan.placement, return_inverse=True)
    first = [int(np.flatnonzero(plan.placement == number)[0]) for number in placements]
    boards = boards_under(rig, plan.swing_pose[first])
    feet = np.stack([np.zeros_like(plan.swing_pose), plan.swing_pose], axis=1)
    load = Load(
        command=plan.joint_angles + plan.feed_forward / m.gain,
        friction=np.zeros(len(m.names)),
        feet=feet,
        plates=boards[placement],
        mass=m.mass,
        center=m.center,
        stands=standing_feet(plan.support),
    )
    near = reference(m, _start(rig, m, plan), load)
    names = [body.name for body in m.bodies]
    links = np.array([names.index(model.body(k).name) for k in range(1, model.nbody)])
    return Prepared(rig, plan, m, near, boards, placement, links, constants(rig))


def standing_feet(support: np.ndarray) -> np.ndarray:
    """Whether the right and the left foot are on the ground, (m, 2) bool."""
    return np.column_stack([np.full(len(support), True), support == "double"])


def run_static(
    prepared: Prepared,
    streams: Sequence[np.random.SeedSequence],
    standard: np.ndarray | None = None,
    all_solved: bool = False,
) -> list[StaticRun]:
    """Repeat the experiment, every run with its own random stream.

    Args:
        standard: true standard parameters by run, (runs, n_links, 4); None: as the rig's scene says.
        all_solved: hand over every posture that has an equilibrium, also one that would not stand as it
            should.

    Raises:
        InputError: a run in which nothing could be measured.
    """
    generators = [np.random.default_rng(stream) for stream in streams]
    tries = [_draw(prepared, k, rng) for k, rng in enumerate(generators)]
    joined = Tries(
        *(np.concatenate(column) for column in zip(*(vars(t).values() for t in tries), strict=True))
    )
    outcome = _outcome(prepared, joined, standard)
    if prepared.later:
        outcome = _in_time(prepared, joined, outcome, standard)
    if all_solved:
        standing = np.where(outcome.reason == NO_EQUILIBRIUM, outcome.reason, "")
        outcome = replace(outcome, reason=standing)
    truth = (
        standard
        if standard is not None
        else np.broadcast_to(nominal(prepared), (len(tries), len(prepared.links), 4))
    )
    return [
        _hand_over(prepared, joined, outcome, joined.run == k, truth[k], rng)
        for k, rng in enumerate(generators)
    ]


def _outcome(prepared: Prepared, tries: Tries, standard: np.ndarray | None) -> Outcome:
    m = prepared.mechanism
    mass, center = _bodies(prepared, standard, tries.run)
    state, load, reason = hold_static(prepared, tries, mass, center)
    forces = cell_forces(m, state, load)
    return Outcome(state.angles[:, m.joints], state.angles[:, m.motors], forces, reason)


def _in_time(prepared: Prepared, tries: Tries, first: Outcome, standard: np.ndarray | None) -> Outcome:
    """Every try in the laboratory that stood there at its time."""
    starts, outcomes = [0.0], [first]
    for start, then in prepared.later:
        added = None if standard is None else standard + (nominal(then) - nominal(prepared))
        starts.append(start)
        outcomes.append(_outcome(then, tries, added))
    used = np.array([outcome.reason == "" for outcome in outcomes])
    stage = np.zeros(len(tries.run), int)
    for run in np.unique(tries.run):
        mine = tries.run == run
        time = start_times(prepared.rig, prepared.placement[tries.row[mine]])
        stage[mine] = stage_at(np.array(starts), time, used[:, mine])
    every = np.arange(len(stage))
    columns = zip(*(vars(outcome).values() for outcome in outcomes), strict=True)
    return Outcome(*(np.array(column)[stage, every] for column in columns))


def hold_static(
    prepared: Prepared, tries: Tries, mass: np.ndarray, center: np.ndarray
) -> tuple[State, Load, np.ndarray]:
    """Equilibria of all tries, and why they could not be used or "", (b,) of text."""
    m, plan, rig = prepared.mechanism, prepared.plan, prepared.rig
    moved = ~tries.fresh
    way = swaying(prepared.near, -float(m.gravity[2] * m.mass.sum()), tries.row, tries.push)
    if m.friction.any() and moved.any():
        pairs, number = np.unique(
            np.column_stack([tries.before, tries.row])[moved], axis=0, return_inverse=True
        )
        closed = plan.support[pairs[:, 1]] == "double"
        start, end = pairs.T
        way[moved] += ways(prepared.near, plan.joint_angles, m.motors, start, end, closed)[number]
    load = Load(
        command=tries.command,
        friction=left_friction(m.friction, way, moved, rig.protocol.move_time, tries.scatter),
        feet=_feet(prepared, tries),
        plates=tries.plates,
        mass=mass,
        center=center,
        stands=standing_feet(plan.support)[tries.row],
    )
    state, solved = solve(m, prepared.near, tries.row, load)
    reason = faults(m, state, load, cell_forces(m, state, load), rig.robot.feet)
    return state, load, np.where(solved, reason, NO_EQUILIBRIUM)


def nominal(prepared: Prepared) -> np.ndarray:
    """Standard parameters of the robot in the rig's scene, (n_links, 4) [kg, kg m]."""
    m = prepared.mechanism
    mass = m.mass[prepared.links]
    return np.column_stack([mass, mass[:, None] * m.center[prepared.links]])


def _draw(prepared: Prepared, run: int, rng: np.random.Generator) -> Tries:
    """What one run tries: repeats, where the plates lie, what is commanded."""
    rig, plan, m = prepared.rig, prepared.plan, prepared.mechanism
    repeats = choose_repeats(plan, rig.protocol.repeats, rng)
    order = [row for number in np.unique(plan.placement) for row, _ in order_of_tries(plan, number, repeats)]
    row = np.array(order)
    place = prepared.placement[row]
    fresh = np.append(True, new_set_up(place, plan.support[row]))
    plates = prepared.boards + rig.protocol.plate_sd * rng.standard_normal(prepared.boards.shape)
    noise = rig.controller.command_sd * rng.standard_normal((len(row), len(plan.joints)))
    offset = plan.feed_forward[row] / m.gain
    return Tries(
        run=np.full(len(row), run),
        row=row,
        before=np.where(fresh, row, np.append(0, row[:-1])),
        fresh=fresh,
        command=plan.joint_angles[row] + noise + offset,
        offset=offset,
        push=rng.standard_normal((len(row), 2)),
        scatter=rng.standard_normal((len(row), len(m.names))),
        plates=plates[place],
    )


def _feet(prepared: Prepared, tries: Tries) -> np.ndarray:
    """Where the feet stand, (b, 2, 3).

    The left one stands where its placement's first command puts it, without the feed-forward's offset.
    """
    m, near = prepared.mechanism, prepared.near.state
    down = np.flatnonzero(tries.fresh)
    angles = np.zeros((len(down), len(m.names)))
    angles[:, m.motors] = tries.command[down] - tries.offset[down]
    angles[:, m.joints] = angles[:, m.motors]
    rows = tries.row[down]
    poses = soles(m, State(near.position[rows], near.rotation[rows], angles, near.wrench[rows]))
    x, y, yaw = (poses[:, 1] - poses[:, 0]).T
    c, s = np.cos(poses[:, 0, 2]), np.sin(poses[:, 0, 2])
    feet = np.zeros((len(down), 2, 3))
    feet[:, 1] = np.column_stack([c * x + s * y, c * y - s * x, yaw])
    return feet[np.cumsum(tries.fresh) - 1]


def _bodies(
    prepared: Prepared, standard: np.ndarray | None, run: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Masses and centres of mass of all bodies, (nb,) and (nb, 3), or by try."""
    m = prepared.mechanism
    if standard is None:
        return m.mass, m.center
    mass = np.tile(m.mass, (len(standard), 1))
    center = np.tile(m.center, (len(standard), 1, 1))
    mass[:, prepared.links] = standard[:, :, 0]
    center[:, prepared.links] = standard[:, :, 1:] / standard[:, :, :1]
    return mass[run], center[run]


def _hand_over(
    prepared: Prepared,
    tries: Tries,
    outcome: Outcome,
    mine: np.ndarray,
    standard: np.ndarray,
    rng: np.random.Generator,
) -> StaticRun:
    """Read the sensors in one run's equilibria."""
    rig, plan = prepared.rig, prepared.plan
    row, why = tries.row[mine], outcome.reason[mine]
    place = prepared.placement[row]
    plates = tries.plates[mine] + record_error(rig, rng, len(prepared.boards))[place]
    used = why == ""
    number = plan.posture[row]
    first = np.isin(np.arange(len(row)), np.unique(number, return_index=True)[1])
    lost = first & ~np.isin(number, number[used])
    dropped = tuple((int(plan.posture[r]), w) for r, w in zip(row[lost], why[lost], strict=True))
    if not used.any():
        raise InputError(f"none of {len(row)} postures could be measured: {'; '.join(sorted(set(why)))}")
    samples = round(rig.protocol.window * rig.sensors.sample_rate)
    joints, motors, forces = (part[mine][used] for part in (outcome.joints, outcome.motors, outcome.forces))
    q, q_sd, motor = read_encoders(rig.sensors, joints, motors, samples, rng, sample_mean)
    cell, cell_sd = read_cells(rig.sensors, forces, samples, rng, sample_mean)
    measured = record(
        rig,
        prepared.fixed,
        {"q": q, "q_std": q_sd, "motor": motor, "cell": cell, "cell_std": cell_sd},
        weigh(rig, float(standard[:, 0].sum()), rng),
        joints=plan.joints,
        posture=plan.posture[row[used]],
        support=plan.support[row[used]],
        placement=plan.placement[row[used]],
        time=start_times(rig, place)[used],
        command=tries.command[mine][used],
        plate_poses=plates[used],
    )
    return StaticRun(measured, dropped, standard)


def _start(rig: Rig, m: Mechanism, plan: PosturePlan) -> State:
    """The planned postures, the weight on both feet alike."""
    chain = ClosedChain(load_model(rig.robot), rig.robot)
    pose = np.array([chain.base_pose(angles) for angles in plan.joint_angles])
    rotation = np.zeros((len(pose), 9))
    for matrix, quaternion in zip(rotation, pose[:, 3:], strict=True):
        mujoco.mju_quat2Mat(matrix, quaternion)
    angles = np.zeros((len(pose), len(m.names)))
    angles[:, m.motors] = plan.joint_angles
    angles[:, m.joints] = plan.joint_angles
    share = standing_feet(plan.support) / standing_feet(plan.support).sum(axis=1)[:, None]
    wrench = np.zeros((len(pose), 2, 6))
    wrench[:, :, :3] = -share[:, :, None] * m.gravity * m.mass.sum()
    return State(pose[:, :3], rotation.reshape(-1, 3, 3), angles, wrench)

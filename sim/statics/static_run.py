"""Run a whole experiment by static equilibrium, a thousand times as fast as in the full dynamics.

Plates are laid, postures commanded and tracked with errors, and sensors read and recorded as in the
dynamics; only the motion of the robot is left out. docs/explanation/equilibrium.md compares the two.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.sim.outcome import Outcome, Truth
from tulip_testbed.sim.procedure import (
    choose_repeats,
    make_measurements,
    new_set_up,
    order_of_tries,
    read_sensors,
    record_error,
    stage_at,
    start_times,
    weigh,
)
from tulip_testbed.sim.sensors import draw_zeros, sample_mean
from tulip_testbed.sim.soft_floor import gravity_on
from tulip_testbed.sim.statics.approach import approach_displacements, friction_at_rest, sway_displacements
from tulip_testbed.sim.statics.forces import Load, StaticState, sole_poses, turned_about_z
from tulip_testbed.sim.statics.sensed_wrenches import sensed_wrenches
from tulip_testbed.sim.statics.solve import cell_forces, faults, solve_by_chord
from tulip_testbed.sim.statics.solved_plan import SolvedPlan, feet_in_base, standard_parameters_of

NO_EQUILIBRIUM = "tipped"
TURNS = 6  # of a floor that yields; each leaves a fifth of the change, or less


@dataclass(frozen=True)
class Tries:
    """The attempts of several runs, run after run, b attempts in all.

    Attributes:
        run, row: index of the run and row of the plan, (b,).
        before: row of the plan from which the robot moves, (b,).
        fresh: whether the robot is put down instead, (b,) bool.
        command: commanded angles, (b, n_joints) [rad].
        offset: part of the command for feed-forward torques, (b, n_joints) [rad].
        push, scatter: standard normal deviates of sway and of dry friction, (b, 2) and (b, n).
        plates: true poses of the plates, (b, 2, 3) [m, m, rad].
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
class Equilibria:
    """Results of the attempts.

    Attributes:
        joints, motors: angles of joints and motors, (b, n_joints) [rad].
        forces: cell forces, (b, 8) [N].
        wrenches: true ones of the wrench sensors, (b, 2, 6) [N, Nm]; (b, 0, 6): no such sensors.
        reason: why an attempt cannot be used, or "", (b,) of text.
    """

    joints: np.ndarray
    motors: np.ndarray
    forces: np.ndarray
    wrenches: np.ndarray
    reason: np.ndarray


def run_statics(
    solved_plan: SolvedPlan,
    streams: Sequence[np.random.SeedSequence],
    standard: np.ndarray | None = None,
    all_solved: bool = False,
) -> list[Outcome]:
    """Run the experiment several times, each run with its own random stream.

    Args:
        standard: true standard parameters by run, (runs, n_links, 4) [kg, kg m]; None means those of the
            rig's scene.
        all_solved: return every posture that has an equilibrium, also those that would slip or lift.

    Raises:
        InputError: in some run no posture could be measured.
    """
    generators = [np.random.default_rng(stream) for stream in streams]
    tries = [_draw(solved_plan, k, rng) for k, rng in enumerate(generators)]
    joined = Tries(
        *(np.concatenate(column) for column in zip(*(vars(t).values() for t in tries), strict=True))
    )
    outcome = _outcome(solved_plan, joined, standard)
    if solved_plan.later:
        outcome = _in_time(solved_plan, joined, outcome, standard)
    if all_solved:
        reason = np.where(outcome.reason == NO_EQUILIBRIUM, outcome.reason, "")
        outcome = replace(outcome, reason=reason)
    truth = (
        standard
        if standard is not None
        else np.broadcast_to(standard_parameters_of(solved_plan), (len(tries), len(solved_plan.links), 4))
    )
    return [
        _read_outcome(solved_plan, joined, outcome, joined.run == k, truth[k], rng)
        for k, rng in enumerate(generators)
    ]


def _outcome(solved_plan: SolvedPlan, tries: Tries, standard: np.ndarray | None) -> Equilibria:
    m = solved_plan.mechanism
    mass, center = _bodies(solved_plan, standard, tries.run)
    state, load, reason = solve_tries(solved_plan, tries, mass, center)
    forces = cell_forces(m, state, load)
    wrenches = sensed_wrenches(solved_plan, state, load)
    return Equilibria(state.angles[:, m.joints], state.angles[:, m.motors], forces, wrenches, reason)


def _in_time(
    solved_plan: SolvedPlan, tries: Tries, first: Equilibria, standard: np.ndarray | None
) -> Equilibria:
    starts, outcomes = [0.0], [first]
    for start, then in solved_plan.later:
        added = (
            None
            if standard is None
            else standard + (standard_parameters_of(then) - standard_parameters_of(solved_plan))
        )
        starts.append(start)
        outcomes.append(_outcome(then, tries, added))
    used = np.array([outcome.reason == "" for outcome in outcomes])
    stage = np.zeros(len(tries.run), int)
    for run in np.unique(tries.run):
        mine = tries.run == run
        time = start_times(solved_plan.rig, solved_plan.placement[tries.row[mine]])
        stage[mine] = stage_at(np.array(starts), time, used[:, mine])
    every = np.arange(len(stage))
    columns = zip(*(vars(outcome).values() for outcome in outcomes), strict=True)
    return Equilibria(*(np.array(column)[stage, every] for column in columns))


def solve_tries(
    solved_plan: SolvedPlan, tries: Tries, mass: np.ndarray, center: np.ndarray
) -> tuple[StaticState, Load, np.ndarray]:
    """Solve all attempts; return states, loads and why each cannot be used or "", (b,) of text."""
    m, plan, rig = solved_plan.mechanism, solved_plan.plan, solved_plan.rig
    moved = ~tries.fresh
    displacement = sway_displacements(
        solved_plan.reference, -float(m.gravity[2] * m.mass.sum()), tries.row, tries.push
    )
    if m.friction.any() and moved.any():
        pairs, number = np.unique(
            np.column_stack([tries.before, tries.row])[moved], axis=0, return_inverse=True
        )
        closed = plan.support[pairs[:, 1]] == "double"
        start, end = pairs.T
        displacement[moved] += approach_displacements(
            solved_plan.reference, plan.joint_angles, m.motors, start, end, closed
        )[number]
    load = Load(
        command=tries.command,
        friction=friction_at_rest(m.friction, displacement, moved, rig.protocol.move_time, tries.scatter),
        feet=_feet(solved_plan, tries),
        plates=tries.plates,
        mass=mass,
        center=center,
        foot_contact=feet_in_contact(plan.support)[tries.row],
    )
    state, solved = solve_by_chord(m, solved_plan.reference, tries.row, load)
    for _ in range(TURNS if any(rig.floor) else 0):
        places = turned_about_z(m.cells, load.plates[..., 2:]) + load.plates[..., None, :2]
        gravity = gravity_on(rig.floor, m.gravity, cell_forces(m, state, load), places.reshape(-1, 8, 2))
        load = replace(load, gravity=gravity)
        state, solved = solve_by_chord(m, solved_plan.reference, tries.row, load)
    reason = faults(m, state, load, cell_forces(m, state, load), rig.robot.feet)
    return state, load, np.where(solved, reason, NO_EQUILIBRIUM)


def _draw(solved_plan: SolvedPlan, run: int, rng: np.random.Generator) -> Tries:
    """Draw one run: repeats, plate poses, commands and friction."""
    rig, plan, m = solved_plan.rig, solved_plan.plan, solved_plan.mechanism
    repeats = choose_repeats(plan, rig.protocol.repeats, rng)
    placements = dict.fromkeys(plan.placement.tolist())
    order = [row for number in placements for row, _ in order_of_tries(plan, number, repeats)]
    row = np.array(order)
    place = solved_plan.placement[row]
    fresh = np.append(True, new_set_up(place, plan.support[row]))
    plates = solved_plan.boards + rig.protocol.plate_sd * rng.standard_normal(solved_plan.boards.shape)
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


def _feet(solved_plan: SolvedPlan, tries: Tries) -> np.ndarray:
    """Return the poses of the feet, (b, 2, 3) [m, m, rad].

    The first command of a set-up places the foot that does not carry the base frame, without the offset for
    feed-forward torques.
    """
    m, near = solved_plan.mechanism, solved_plan.reference.state
    down = np.flatnonzero(tries.fresh)
    angles = np.zeros((len(down), len(m.names)))
    angles[:, m.motors] = tries.command[down] - tries.offset[down]
    angles[:, m.joints] = angles[:, m.motors]
    rows = tries.row[down]
    poses = sole_poses(m, StaticState(near.position[rows], near.rotation[rows], angles, near.wrench[rows]))
    feet = feet_in_base(poses, solved_plan.plan.support[rows])
    return feet[np.cumsum(tries.fresh) - 1]


def _bodies(
    solved_plan: SolvedPlan, standard: np.ndarray | None, run: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return masses and centres of mass of all bodies, (nb,) [kg] and (nb, 3) [m], or by attempt."""
    m = solved_plan.mechanism
    if standard is None:
        return m.mass, m.center
    mass = np.tile(m.mass, (len(standard), 1))
    center = np.tile(m.center, (len(standard), 1, 1))
    mass[:, solved_plan.links] = standard[:, :, 0]
    heavy = standard[0, :, 0] > 0
    links = solved_plan.links[heavy]
    center[:, links] = standard[:, heavy, 1:] / standard[:, heavy, :1]
    return mass[run], center[run]


def _read_outcome(
    solved_plan: SolvedPlan,
    tries: Tries,
    outcome: Equilibria,
    mine: np.ndarray,
    standard: np.ndarray,
    rng: np.random.Generator,
) -> Outcome:
    """Read the sensors in one run's equilibria and assemble its outcome."""
    rig, plan = solved_plan.rig, solved_plan.plan
    row, why = tries.row[mine], outcome.reason[mine]
    place = solved_plan.placement[row]
    plates = tries.plates[mine] + record_error(rig, rng, len(solved_plan.boards))[place]
    used = why == ""
    number = plan.posture[row]
    first = np.isin(np.arange(len(row)), np.unique(number, return_index=True)[1])
    lost = first & ~np.isin(number, number[used])
    dropped = tuple((int(plan.posture[r]), w) for r, w in zip(row[lost], why[lost], strict=True))
    if not used.any():
        raise InputError(f"none of {len(row)} postures could be measured: {'; '.join(sorted(set(why)))}")
    joints, motors, forces, wrenches = (
        part[mine][used] for part in (outcome.joints, outcome.motors, outcome.forces, outcome.wrenches)
    )
    sensors = rig.sensors.wrench
    zeros = None if sensors is None else draw_zeros(sensors, rng)
    reading = read_sensors(rig, joints, motors, forces, wrenches, zeros, rng, sample_mean)
    truth = Truth(float(standard[:, 0].sum()), standard, dropped)
    if sensors is not None:
        truth = replace(truth, wrenches=wrenches, zeros=zeros)
    measured = make_measurements(
        rig,
        solved_plan.header,
        reading,
        weigh(rig, truth.mass, rng),
        posture=plan.posture[row[used]],
        support=plan.support[row[used]],
        placement=plan.placement[row[used]],
        time=start_times(rig, place)[used],
        command=tries.command[mine][used],
        plate_poses=plates[used],
    )
    return Outcome(measured, truth)

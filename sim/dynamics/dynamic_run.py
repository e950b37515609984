"""Run a whole experiment in the full dynamics: hold, measure and record every placement of a plan."""

import dataclasses
from collections.abc import Callable, Sequence

import joblib
import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.base.workers import deaf_to_interruptions, watched
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim import procedure
from tulip_testbed.sim.dynamics.hold import hold, move, put_down
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.outcome import Attempt, Outcome, Truth, dropped_postures
from tulip_testbed.sim.plan_folder import check_support
from tulip_testbed.sim.rig import Rig, stages
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.sensors import draw_zeros


def run_dynamics(
    rig: Rig,
    plan: PosturePlan,
    seed: int,
    workers: int = 1,
    progress: Callable[[int], None] = lambda count: None,
) -> Outcome:
    """Simulate a plan in the full dynamics.

    Every placement has its own random stream, so that the result does not depend on `workers`. Each time one
    is done, `progress` is called with the number of its attempts.
    """
    check_support("plan", plan)
    placements = list(dict.fromkeys(plan.placement.tolist()))
    streams = np.random.SeedSequence(seed).spawn(len(placements) + 1)
    shared = np.random.default_rng(streams[-1])
    repeats = procedure.choose_repeats(plan, rig.protocol.repeats, shared)
    sensors = rig.sensors.wrench
    zeros = None if sensors is None else draw_zeros(sensors, shared)
    attempts = tuple(_try_all(rig, plan, repeats, zeros, streams, workers, progress))
    truth = dataclasses.replace(truth_of(rig), dropped=dropped_postures(attempts), attempts=attempts)
    if sensors is not None:
        truth = dataclasses.replace(
            truth, wrenches=np.array([held.wrenches for held in truth.held]), zeros=zeros
        )
    return Outcome(_measurements(rig, plan, attempts, truth.mass, shared), truth)


def truth_of(rig: Rig) -> Truth:
    """Return mass and standard parameters of the robot that stands in a laboratory."""
    model, nominal = Stand(rig, np.zeros((2, 3))).model, rig.robot.model
    links = [model.body(nominal.body(k).name).id for k in range(1, nominal.nbody)]
    mass = model.body_mass[links]
    standard = np.column_stack([mass, mass[:, None] * model.body_ipos[links]])
    return Truth(mass=float(model.body_subtreemass[links[0]]), standard=standard, dropped=())


def _try_all(
    rig: Rig,
    plan: PosturePlan,
    repeats: frozenset[int],
    zeros: np.ndarray | None,
    streams: list[np.random.SeedSequence],
    workers: int,
    progress: Callable[[int], None],
) -> list[Attempt]:
    """Make all attempts in order, each with the rig that is in place at its time.

    A placement during which the rig changes is simulated with both rigs.
    """
    starts, rigs = zip(*stages(rig), strict=True)
    placements = list(dict.fromkeys(plan.placement.tolist()))
    tries = [
        (place, k) for place in placements for k in range(len(procedure.order_of_tries(plan, place, repeats)))
    ]
    time = procedure.start_times(rig, np.array([place for place, _ in tries]))
    done: dict[tuple[int, int], list[Attempt]] = {}  # by placement and number of the rig
    used = np.ones((len(rigs), len(tries)), bool)
    while True:
        stage = procedure.stage_at(np.array(starts), time, used).tolist()
        wanted = dict.fromkeys((place, s) for (place, _), s in zip(tries, stage, strict=True))
        if not (missing := [key for key in wanted if key not in done]):
            return [done[place, s][k] for (place, k), s in zip(tries, stage, strict=True)]
        jobs = (
            joblib.delayed(run_placement)(
                rigs[s], plan, place, repeats, streams[placements.index(place)], zeros
            )
            for place, s in missing
        )
        # joblib would start all workers, even more than there are placements.
        parallel = joblib.Parallel(min(workers, len(missing)), return_as="generator", **watched())
        with deaf_to_interruptions():
            runs = parallel(jobs)
        for key, attempts in zip(missing, runs, strict=True):
            done[key] = attempts
            progress(len(attempts))
        for number, (place, k) in enumerate(tries):
            for s in range(len(rigs)):
                if (place, s) in done:
                    used[s, number] = done[place, s][k].held is not None


@one_blas_thread  # joblib gives a worker the threads that others leave idle
def run_placement(
    rig: Rig,
    plan: PosturePlan,
    placement: int,
    repeats: frozenset[int],
    stream: np.random.SeedSequence,
    zeros: np.ndarray | None = None,
) -> list[Attempt]:
    """Set up one placement and attempt its postures, then its repeats; the wrench sensors' zeros are true."""
    rng = np.random.default_rng(stream)
    order = procedure.order_of_tries(plan, placement, repeats)
    boards = boards_under(rig, plan.foot_poses[[order[0][0]]])[0]
    stand = Stand(rig, boards + rig.protocol.plate_sd * rng.standard_normal((2, 3)))
    error = procedure.record_error(rig, rng, 1)[0]
    attempts: list[Attempt] = []
    before, recorded = None, np.zeros((2, 3))
    fresh = np.append(
        True, plan.support[[r for r, _ in order[1:]]] != plan.support[[r for r, _ in order[:-1]]]
    )
    for (row, repeat), put_down_again in zip(order, fresh, strict=True):
        planned = plan.joint_angles[row]
        sent = planned + rig.controller.command_sd * rng.standard_normal(len(planned))
        command = sent + stand.offset(plan.feed_forward[row])
        if before is None or put_down_again:
            put_down(stand, sent, str(plan.support[row]), command)
            if not attempts:
                recorded = stand.plates_in_base() + error
        else:
            move(stand, before, planned, command)
        held, reason = hold(stand, planned)
        before = planned if held else None
        reading = {}
        if held:
            true = (held.joint_angles, held.motor_angles, held.cell_forces, held.wrenches)
            reading = procedure.read_sensors(rig, *true, zeros, rng)
        number, true_plates = int(plan.posture[row]), stand.plates_in_base()
        attempts.append(Attempt(number, placement, repeat, held, reason, reading, recorded, true_plates))
    return attempts


def _measurements(
    rig: Rig, plan: PosturePlan, attempts: Sequence[Attempt], mass: float, rng: np.random.Generator
) -> Measurements:
    times = procedure.start_times(rig, np.array([a.placement for a in attempts]))
    used = [(a, t) for a, t in zip(attempts, times, strict=True) if a.held]
    if not used:
        reasons = sorted({a.reason for a in attempts})
        raise InputError(f"none of {len(attempts)} postures could be measured: {'; '.join(reasons)}")
    support = dict(zip(plan.posture.tolist(), plan.support.tolist(), strict=True))
    return procedure.make_measurements(
        rig,
        procedure.header_of(rig),
        {key: np.array([a.reading[key] for a, _ in used]) for key in used[0][0].reading},
        procedure.weigh(rig, mass, rng),
        posture=np.array([a.posture for a, _ in used]),
        support=np.array([support[a.posture] for a, _ in used]),
        placement=np.array([a.placement for a, _ in used]),
        time=np.array([t for _, t in used]),
        command=np.array([a.held.commanded for a, _ in used if a.held]),
        plate_poses=np.array([a.plates for a, _ in used]),
    )

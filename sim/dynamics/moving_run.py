"""Run a plan that moves in the full dynamics: the servos follow its trajectory, sensors are sampled."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import joblib
import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.base.workers import deaf_to_interruptions, watched
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.logs.series_reduction import reduced_motion, usual_window
from tulip_testbed.measurements.trajectory import RATE, Trajectory, runs
from tulip_testbed.sim.compliance import lagging
from tulip_testbed.sim.dynamics.dynamic_run import truth_of
from tulip_testbed.sim.dynamics.hold import hold, move, put_down
from tulip_testbed.sim.dynamics.stand import Stand, hoist_damping
from tulip_testbed.sim.outcome import MovingOutcome
from tulip_testbed.sim.procedure import header_of, make_measurements, read_sensors, record_error, weigh
from tulip_testbed.sim.rig import Rig, stages
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.sensors import delayed, draw_zeros, sample_series

# Time constant tc [s] and impedance of the contacts below moving legs. MuJoCo's constraints leave the
# centripetal acceleration of a sole corner out, some 0.03 m/s2, which lifts it by 0.03 tc^2. In the contacts
# of a hold that is more than the weight presses it in: single steps lose a contact, and with it a tenth of
# the weight. In these the centre of pressure agrees with the motion within 0.04 mm.
CONTACT = (0.005, 0.995)
# Of springs' damping, assumed. It lets a hold come to rest; in a motion they would follow 40 ms late by it.
FREELY = 0.2
STICKS = 100.0  # MuJoCo's `impratio`: with that of a hold, feet creep 0.2 mm in 80 s, with this one 0.03 mm
REST = 0.02  # of a segment's largest speed, below which it rests
SLIP = 1e-3  # m, of a foot on its plate in a motion, beyond which the recorded poses are wrong


class _Segment(NamedTuple):
    """Readings of the sensors in a segment, or in a part of one, to where the robot tips.

    Attributes:
        number: place in the trajectory. first: sample of it at which the robot began, or began again.
        command: (k, n_joints) [rad]. readings: see `read_sensors`, (k, ...).
        plates: recorded poses, (2, 3) [m, m, rad]. good: which samples can be used, (k,).
        reason: why some cannot, or "".
    """

    number: int
    first: int
    command: np.ndarray
    readings: dict[str, np.ndarray]
    plates: np.ndarray
    good: np.ndarray
    reason: str


def run_motion(
    rig: Rig,
    plan: PosturePlan,
    seed: int,
    workers: int = 1,
    progress: Callable[[int], None] = lambda count: None,
) -> MovingOutcome:
    """Simulate a plan that moves in the full dynamics.

    The robot stands as for a hold before every segment; if it cannot hold the first posture, the segment
    begins at the next one, and so it does if the robot tips on the way. Samples at which a foot has lifted or
    slipped are left out, and a new segment begins behind them; the truth says why. Every placement has its
    own random stream, so that the result does not depend on `workers`. `progress` is called with the number
    of segments of each part that is done.
    """
    motion = plan.motion
    assert motion is not None
    rig = replace(rig, protocol=replace(rig.protocol, window=usual_window(rig.sensors.encoder_resolution)))
    placements = list(dict.fromkeys(motion.placement.tolist()))
    streams = np.random.SeedSequence(seed).spawn(len(placements) + 1)
    shared = np.random.default_rng(streams[-1])
    zeros = None if rig.sensors.wrench is None else draw_zeros(rig.sensors.wrench, shared)
    time = _times(rig, motion)
    begins, rigs = zip(*stages(rig), strict=True)
    first = [rows.start for rows in motion.segments]
    part_of_time = (time[first] - time[0]) / max(np.ptp(time), 1e-9)
    stage = np.searchsorted(begins, part_of_time, side="right") - 1
    parts: dict[tuple[int, int], list[int]] = {}
    for number, row in enumerate(first):
        parts.setdefault((int(motion.placement[row]), int(stage[number])), []).append(number)
    jobs = (
        joblib.delayed(_move_on_placement)(rigs[s], plan, numbers, streams[placements.index(place)], zeros)
        for (place, s), numbers in parts.items()
    )
    parallel = joblib.Parallel(min(workers, len(parts)), return_as="generator", **watched())
    with deaf_to_interruptions():
        done = parallel(jobs)
    segments: list[_Segment] = []
    for some in done:
        segments += some
        progress(len({one.number for one in some}))
    segments.sort(key=lambda segment: segment.number)
    dropped = {int(motion.segment[first[one.number]]): one.reason for one in segments if one.reason}
    truth = replace(truth_of(rig), zeros=zeros, dropped=tuple(dropped.items()))
    samples = _samples(rig, motion, time, segments, weigh(rig, truth.mass, shared))
    return MovingOutcome(reduced_motion(samples), truth, samples)


def _times(rig: Rig, motion: Trajectory) -> np.ndarray:
    """Return the time of the experiment at every sample, with what lies between segments, (n,) [s]."""
    p, now, before, out = rig.protocol, 0.0, None, np.empty(len(motion))
    for rows in motion.segments:
        placement = motion.placement[rows.start]
        now += (p.move_time if placement == before else p.placement_time) + p.rest_time + p.calm_time
        out[rows] = now + motion.time[rows] - motion.time[rows.start]
        now, before = float(out[rows][-1]), placement
    return out


@one_blas_thread
def _move_on_placement(
    rig: Rig, plan: PosturePlan, numbers: list[int], stream: np.random.SeedSequence, zeros: np.ndarray | None
) -> list[_Segment]:
    """Set up a placement and follow these segments; zeros of wrench sensors are true, (2, c) [N, Nm]."""
    motion, rng = plan.motion, np.random.default_rng(stream)
    assert motion is not None
    there = np.flatnonzero(plan.placement == motion.placement[motion.segments[numbers[0]].start])
    boards = boards_under(rig, plan.foot_poses[there[:1]])[0]
    stand = Stand(rig, boards + rig.protocol.plate_sd * rng.standard_normal((2, 3)))
    error, recorded = record_error(rig, rng, 1)[0], None
    read = partial(sample_series, interval=1 / RATE, changing_time=rig.sensors.changing_time)
    before, support, out = None, "", []
    for number in numbers:
        rows = motion.segments[number]
        noise = rig.controller.command_sd * rng.standard_normal(len(plan.joints))
        feed = np.zeros_like(motion.joint_angles[rows]) if motion.torques is None else motion.torques[rows]
        sent = motion.joint_angles[rows] + noise + stand.offset(feed)
        angles, lost, before_this = motion.joint_angles[rows], "", len(out)
        stops = _stops(angles, round(rig.protocol.window * RATE))
        while stops:
            first, *stops = stops
            start = angles[first]
            if before is None or motion.support[rows.start] != support:
                support = str(motion.support[rows.start])
                put_down(stand, start + noise, support, sent[first])
            else:
                move(stand, before, start, sent[first])
            recorded = stand.plates_in_base() + error if recorded is None else recorded
            held, reason = hold(stand, start)
            before, lost = None, lost or reason or ""
            if held is None:
                continue
            states, good, reason = _follow(stand, motion.time[rows][first:], angles[first:], sent[first:])
            joints, motors = states[:2]
            forces, wrenches = (delayed(rig.sensors, each, 1 / RATE) for each in states[2:])
            readings = read_sensors(rig, joints, motors, forces, wrenches, zeros, rng, read)
            end, lost = first + len(good), lost or reason
            out.append(_Segment(number, first, sent[first:end], readings, recorded, good, lost))
            stops = [stop for stop in stops if stop >= end]
            before = None if end < len(sent) else angles[-1]
        if len(out) == before_this:
            assert recorded is not None  # a segment has a first stop
            out.append(_Segment(number, 0, sent[:0], {}, recorded, np.zeros(0, bool), lost))
    return out


def _stops(angles: np.ndarray, least: int) -> list[int]:
    """Return the samples at which a segment rests and can begin, at least some samples before its end."""
    speed = np.abs(np.diff(angles, axis=0)).max(axis=1)
    slow = speed < REST * speed.max()
    stops = [rows.start + int(speed[rows].argmin()) for rows in runs(slow) if slow[rows.start]]
    return [0, *(stop for stop in stops[1:] if stop < len(angles) - least)]


def _follow(
    stand: Stand, time: np.ndarray, angles: np.ndarray, sent: np.ndarray
) -> tuple[list[np.ndarray], np.ndarray, str]:
    """Follow a trajectory with free feet from rest.

    The servos damp the joint's own speed, so the command leads by their derivative time, as in `move`.

    Args:
        angles: planned, sent: commanded, (n, n_joints) [rad].

    Returns:
        states of the samples: angles of joints and motors, forces of the cells, wrenches, (k, ...) each, of
        n samples or of those before the robot tipped; whether they can be used, (k,); why some cannot, or "".
    """
    model, data = stand.model, stand.data
    every = round(1 / RATE / model.opt.timestep)  # steps from one sample to the next
    path = CubicSpline(time, sent, bc_type="clamped")
    fine = np.minimum(time[0] + model.opt.timestep * np.arange(every * len(time)), time[-1])
    # A new command in every step: the force would differ between the first step after one and the others.
    commands = path(fine) + stand.rig.controller.derivative_time * path(fine, 1)
    states, good, reason = [], [], ""
    with _moving(stand):
        for k, planned in enumerate(angles):
            joints, motors = data.qpos[stand.qpos].copy(), data.qpos[stand.motors].copy()
            for step in range(every * k, every * (k + 1)):
                stand.command = commands[step]
                mujoco.mj_step(model, data)
                stand.turn_floor()
                if step == every * k:  # sensors are those of the state before the step
                    states.append((joints, motors, stand.cell_forces(), stand.wrenches()))
            fault = stand.fault(SLIP) or ""
            good.append(not fault)
            reason = reason or fault
            unstable = "MuJoCo warned of an unstable simulation" * bool(data.warning.number.any())
            if unstable or stand.tipped(stand.chain.base_pose(planned, stand.base)):
                reason, good[-1] = unstable or "tipped", False
                break
    return [np.array(each) for each in zip(*states, strict=True)], np.array(good), reason


@contextmanager
def _moving(stand: Stand) -> Iterator[None]:
    """Let joints and feet move: no sticking, no hoist, and contacts that hold below moving legs."""
    model = stand.model
    kept = model.pair_solref.copy(), model.pair_solimp.copy(), model.dof_damping.copy()
    impratio, model.opt.impratio = model.opt.impratio, STICKS
    first = model.jnt_dofadr[stand.free]
    stand.stiction.release(stand.data)
    model.dof_damping[first : first + 6] -= hoist_damping(stand.rig)
    model.dof_damping[lagging(model)] *= FREELY
    model.pair_solref[:, 0], model.pair_solimp[:, :2] = CONTACT[0], CONTACT[1]
    try:
        yield
    finally:
        model.pair_solref[:], model.pair_solimp[:], model.dof_damping[:] = kept
        model.opt.impratio = impratio


def _samples(
    rig: Rig, motion: Trajectory, time: np.ndarray, segments: list[_Segment], weighed: tuple[float, float]
) -> Measurements:
    """Join the good samples of all segments; of several runs of them in a segment, each is a segment."""
    least = rig.protocol.window * RATE
    used, rows = [], []  # which samples of which segment, and where they are in the trajectory
    for one in segments:
        begin = motion.segments[one.number].start + one.first
        for run in runs(one.good):
            if one.good[run.start] and run.stop - run.start > least:
                used.append((one, run))
                rows.append(np.arange(begin + run.start, begin + run.stop))
    if not used:
        reasons = sorted({one.reason for one in segments})
        raise InputError(f"none of {len(segments)} segments could be measured: {'; '.join(reasons)}")
    at = np.concatenate(rows)
    readings = {
        key: np.concatenate([one.readings[key][run] for one, run in used]) for key in used[0][0].readings
    }
    return make_measurements(
        replace(rig, protocol=replace(rig.protocol, window=1 / RATE)),
        header_of(rig),
        readings,
        weighed,
        posture=np.repeat(np.arange(1, len(rows) + 1), [len(some) for some in rows]),
        placement=motion.placement[at],
        support=motion.support[at],
        time=time[at],
        command=np.concatenate([one.command[run] for one, run in used]),
        plate_poses=np.concatenate([np.tile(one.plates, (run.stop - run.start, 1, 1)) for one, run in used]),
    )

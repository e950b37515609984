"""Close the loop: plan, protocol, a day with a fault, watch, identify, export, new postures (docs/studies/loop.md).

Random true robots are measured in the full dynamics on force plates, in the order of the protocol. A fault
begins at the 40th row. Once `tulip watch` notices it, the laboratory repairs it and measures again, in a set-up
of its own, every posture since the one that the watch names. The estimate is exported. MuJoCo loads the file
and computes the centre of pressure of 100 new random postures (a minute and a half for a robot).
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from scipy.stats import chi2

import tulip_testbed as tt
from studies.runner import Settings, header, row, shipped_plan
from studies.study_export import pressure
from studies.watched_days import FAULTS, ONSET, Day, Kind, faulty_day, joined_rows
from tulip_testbed.base.errors import InputError
from tulip_testbed.calibration.families import EXACT
from tulip_testbed.calibration.prediction import predicted
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.effects.injection import edited
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.usable_plan import random_plan
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.specs import compile_spec

SETTINGS = Settings(seed=13000, workers=1)
ROBOTS, SPREAD, PRESET = 10, 0.2, "force-plate"
PLACEMENTS, POSTURES = 20, 5  # of the new postures
TRIES, LEAST_ROWS = 10, 100
PAUSE = 600.0  # s, until the laboratory has mended the fault


@dataclass(frozen=True)
class Loop:
    """The result of one robot.

    Attributes:
        late: postures between the detectable fault and the watch's notice; None: not noticed.
        early: whether there was a false alarm before.
        rows: measured in all. cad, exported: r.m.s. error of the centre of pressure [m].
        square, freedom: chi-square of the noisy residuals of the new postures.
    """

    fault: str
    late: int | None
    early: bool
    rows: int
    cad: float
    exported: float
    square: float
    freedom: int


def study(settings: Settings) -> Iterator[str]:
    """Yield a row a robot, and how many reach what they must."""
    robot = load_robot()
    with tempfile.TemporaryDirectory() as folder:
        plan = tt.protocol(shipped_plan(robot), Path(folder) / "day", robot, PRESET).plan
    count = settings.count(ROBOTS)
    calls = [(settings.seed + k, plan, FAULTS[k % len(FAULTS)]) for k in range(count)]
    found = settings.parallel("robots", carry_out, calls)
    yield header("fault", "noticed after", "rows", "CAD, mm", "exported, mm", "exported over CAD", "p")
    for one in found:
        yield row(
            one.fault,
            "a false alarm before" if one.early else "never" if one.late is None else one.late,
            one.rows,
            f"{1e3 * one.cad:.2f}",
            f"{1e3 * one.exported:.2f}",
            f"{one.exported / one.cad:.3f}",
            f"{chi2.sf(one.square, one.freedom):.2g}",
        )
    good = sum(one.exported <= one.cad / 2 for one in found)
    inside = sum(0.025 <= chi2.sf(one.square, one.freedom) <= 0.975 for one in found)
    soon = sum(not one.early and one.late is not None and one.late <= 3 for one in found)
    yield (
        f"\n{soon} of {len(found)} faults are noticed within three postures of their becoming detectable; "
        f"{good} exported models have at most half of CAD's error; the noisy residuals of {inside} lie in "
        "the 95 % range of chi-square."
    )


def carry_out(seed: int, plan: PosturePlan, kind: Kind) -> Loop:
    """Go through the loop with one random robot."""
    robot = load_robot()
    truth, day = _clean_day(seed, plan, robot)
    seen = faulty_day(day, kind, plan, seed, float(day.rows.time[ONSET - 1]))
    measured = _mended(day, plan, seen.began)
    found = tt.identify(measured, robot)
    with tempfile.TemporaryDirectory() as folder:
        made = tt.export_model(found, robot, out=Path(folder) / "robot.xml", samples=0)
        exported = mujoco.MjModel.from_xml_path(str(made.files[0]))
    new = random_plan(robot, PLACEMENTS, POSTURES, seed)
    true = pressure(truth, robot, new.joint_angles)
    cad, ours = (
        float(np.sqrt(((pressure(model, robot, new.joint_angles) - true) ** 2).sum(axis=1).mean()))
        for model in (robot.model, exported)
    )
    square, freedom = _noisy(
        measured, _run(day.laboratory, new, seed + 1), made.base_parameters, found.full.covariance, robot
    )
    late = None if seen.noticed < 0 else seen.late
    return Loop(kind.label, late, seen.early, len(measured), cad, ours, square, freedom)


def _clean_day(seed: int, plan: PosturePlan, robot: Robot) -> tuple[mujoco.MjModel, Day]:
    """Draw a robot that stands, and measure the plan with it."""
    rng = np.random.default_rng(seed)
    for _ in range(TRIES):
        stream, edit = int(rng.integers(2**31)), edit_of(robot.model, draw_robot(robot.model, SPREAD, rng))
        spec = robot.spec.copy()
        edit(spec)
        laboratory = Laboratory(robot, PRESET, nominal=edited(preset_rig(PRESET, robot), edit))
        rows = _run(laboratory, plan, stream)
        if len(rows) >= LEAST_ROWS:
            return compile_spec(spec, "true robot"), Day(laboratory, rows, stream, "dynamics")
    raise InputError(f"seed {seed}: found no robot that stands")


def _run(laboratory: Laboratory, plan: PosturePlan, stream: int) -> Measurements:
    return laboratory.run(plan, stream, "dynamics", workers=1).measurements


def _mended(day: Day, plan: PosturePlan, began: int) -> Measurements:
    """Return the rows before the fault, and the others measured again, the robot set down again."""
    before = day.rows.take(np.arange(began))
    again = _run(day.laboratory, plan, day.stream + 1)
    done = set(zip(before.posture.tolist(), before.placement.tolist(), strict=True))
    every = zip(again.posture.tolist(), again.placement.tolist(), strict=True)
    left = again.take(np.array([one not in done for one in every]))
    placement = np.where(left.placement == before.placement[-1], plan.placement.max() + 1, left.placement)
    later = before.time[-1] + PAUSE - left.time[0]
    return joined_rows(before, replace(left, placement=placement, time=left.time + later))


def _noisy(
    measured: Measurements, new: Measurements, value: np.ndarray, covariance: np.ndarray, robot: Robot
) -> tuple[float, int]:
    """Return chi-square of the centre of pressure of new postures by the exported base parameters.

    The covariance is that of the noise, and the one that `tulip identify` states for its estimate.
    """
    nominal, of = nominal_robot(robot), slice(len(value))
    found = self_calibrate(observe(measured, nominal), EXACT, rounds=1)
    estimate, stated = found.solved.estimate.copy(), found.solved.covariance.copy()
    estimate[of], stated[of], stated[:, of] = value, 0.0, 0.0
    stated[of, of] = covariance
    exported = replace(found, solved=replace(found.solved, estimate=estimate, covariance=stated))
    left = predicted(exported, observe(new, nominal)).of("A")
    return left.chi_square, len(left.residual)

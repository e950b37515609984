"""Judge the tool on simulated records like a real humanoid's on one foot, whose truth is known (hours, resumable).

Each has other masses (10 %), a rocking sole, cross-talk of 1 %, and a wrench in axes, about a point and with a
sign that nobody states. The robots' files are not ours; docs/studies/real-robots.md says where they are from.
Every step of a case is kept, with its seconds; after Ctrl-C the study reports on the steps so far.
"""

import json
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import tulip_testbed as tt
from studies.real_robots.records import Truth, true_spec, write_record
from studies.runner import Settings, header, row, share
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import write_text
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.experiments.posture_splits import by_halves
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.measurements.contacts import WRENCH
from tulip_testbed.sim.robot import Robot, joint_names

ICUB, OTHERS = "TULIP_ICUB_YOGA", "TULIP_PUBLISHED_ROBOTS"  # variables of the environment that name folders
ROBOTS = {  # a folder's variable and a file there; feet and soles that it does not tell; parts that no log has
    "icub": (ICUB, "iCubGenova02.urdf", ("r_ankle_2", "l_ankle_2"), (0.14, 0.06, 0.09, 0.0645), "wrist neck"),
    "g1": (OTHERS, "g1_29dof.urdf", None, None, ""),
    "talos": (OTHERS, "talos.urdf", ("leg_right_6_link", "leg_left_6_link"), (0.1, 0.1, 0.13, 0.107), ""),
}
CASES, WORSE = 30, 1.05
AXES = {"sensor": "sensor", "base": "base link", "world": "world"}
SIGNS = {1: "of the ground on the robot", -1: "of the robot on the ground"}
ROCKING, CROSS_TALK = {"foot-compliance", "sole-compliance"}, {"wrench-crosstalk"}
ALSO_TRUE = {"wrench-rotation", "wrench-origin", "wrench-zero", "encoder-offset"}
MEASURED = "measured"


@dataclass(frozen=True)
class RealRobots(Settings):
    """How the study is run."""

    soft: bool = False
    """soles up to 0.8 of tipping, as the real robot's, in place of 0.06 to 0.16"""


SETTINGS = RealRobots(seed=60000, only=tuple(ROBOTS))


def audit(robot: Robot, truth: Truth, folder: Path) -> dict[str, Any]:
    """Return what the import says of a log's axes and sign."""
    log = folder / "record"
    found = tt.import_table(log / "series.csv", robot, out=folder / MEASURED, map=[str(log / "MAP.toml")])
    told = {c["what"]: c["hypothesis"] for c in found.to_json()["conventions"] if c["applied"]}
    axes, sign = (told.get(f"{what} of the wrench", "") for what in ("axes", "sign"))
    published = "published" in axes or truth.frame != "base" or robot.model.body_quat[1, 0] == 1
    right = AXES[truth.frame] in axes and published and sign == SIGNS[truth.sign]
    if found.folder is None:
        raise InputError(f"no folder: {found.problems[0]}")
    return {"frame right": right, "axes": axes, "sign": sign}


def predict(robot: Robot, truth: Truth, folder: Path) -> dict[str, Any]:
    """Return how the models do on held-out halves, both ways."""
    m, squares = tt.read_measurements(folder / MEASURED), {}
    for rows in by_halves(m).folds:
        train, test = ([f"{m.posture[part].min()}-{m.posture[part].max()}"] for part in rows)
        for one in tt.predict(folder / MEASURED, robot, train=train, test=test).models:
            square = len(rows[1]) * (one.rms_mm.x**2 + one.rms_mm.y**2)
            squares[one.name] = squares.get(one.name, 0.0) + square / len(m)
    rms = {name: float(np.sqrt(square)) for name, square in squares.items()}
    ratio = rms["identified with corrections"] / rms["CAD with offset"]
    return {"beats CAD with offset": ratio < 1, "worse by 5 %": ratio > WORSE, "rms_mm": rms}


def identify(robot: Robot, truth: Truth, folder: Path) -> dict[str, Any]:
    """Return which intervals of the base parameters hold the truth, and the error of the mass."""
    found, model = tt.identify(folder / MEASURED, robot), true_spec(robot, truth).compile()
    of = base_parameters(robot, model, found.parameters.support)
    true, ends = of.values(standard_parameters(model)), [found[n].interval95 for n in of.names]
    inside = [bool(low <= value <= high) for value, (low, high) in zip(true, ends, strict=True)]
    mass, error = found.mass
    return {"inside": inside, "mass_z": (mass - float(model.body_mass.sum())) / error}


def discover(robot: Robot, truth: Truth, folder: Path) -> dict[str, Any]:
    """Return what discovery names, and which planted effects a reader sees."""
    found = tt.discover(folder / MEASURED, robot, check=False)
    adopted = {one.effect.name for one in found.adopted}
    named = adopted | {one.instance.effect.name for one in found.explanations}
    compliance = {
        f"foot-compliance:left, about {axis}": k for axis, k in zip("xy", truth.compliance, strict=True)
    }
    parts = {
        f"wrench-crosstalk:left.{WRENCH[j]}.{WRENCH[k]}": part
        for j, row in enumerate(np.array(truth.cross_talk) - np.eye(6))
        for k, part in enumerate(row)
    }
    return {
        "rocking": bool(named & ROCKING) or seen(found, compliance),
        "cross-talk": bool(named & CROSS_TALK) or seen(found, parts),
        "false name": not adopted <= ROCKING | CROSS_TALK | ALSO_TRUE,
        "verdict": found.verdict,
        "adopted": sorted(adopted),
        "named": sorted(named),
    }


def seen(found: tt.Discovered, true: dict[str, float]) -> bool:
    """Whether the ordinary imperfections that were found hold an effect with its size.

    The data determine a member, its 95 % interval leaves zero out, and holds the truth.
    """
    return any(
        known and not low <= 0 <= high and low <= true.get(label, np.nan) <= high
        for one in found.families
        for label, known, (low, high) in zip(one.family.labels, one.determined, one.interval95, strict=True)
    )


STEPS = {one.__name__: one for one in (audit, predict, identify, discover)}
JUDGED = (
    "frame right",
    "beats CAD with offset",
    "worse by 5 %",
    "inside",
    "rocking",
    "cross-talk",
    "false name",
)


@one_blas_thread
def carry_out(robot: Robot, seed: int, not_logged: tuple[str, ...], soft: bool, case: Path) -> None:
    """Carry out the steps of a case whose files are not there yet; the others need the audit's folder."""
    hidden = case / "truth.json"
    case.mkdir(parents=True, exist_ok=True)
    for step in STEPS:
        kept = case / f"{step}.json"
        if kept.exists() or (step != "audit" and not (case / MEASURED).exists()):
            continue
        with TemporaryDirectory(dir=case) as scratch:
            folder = Path(scratch)
            if step == "audit":
                truth = write_record(robot, seed, folder / "record", not_logged, soft=soft)
                write_text(hidden, json.dumps(asdict(truth)))
            else:
                truth = Truth(**json.loads(hidden.read_bytes()))
                (folder / MEASURED).symlink_to((case / MEASURED).resolve())
            began = time.process_time()
            try:
                said = STEPS[step](robot, truth, folder)
            except Exception as error:  # whatever it is, the tool has failed on this record
                said = {"failed": f"{step}: {type(error).__name__}: {error}"[:200]}
            if step == "audit" and (folder / MEASURED).exists():
                (folder / MEASURED).rename(case / MEASURED)
        write_text(kept, json.dumps(said | {"seconds": time.process_time() - began}, indent=1) + "\n")


def study(settings: RealRobots) -> Iterator[str]:
    """Yield a table with a row for each robot, and where the tool refused."""
    judged, spent, refusals = [], [], []
    folder, count = settings.folder("real-robots"), settings.count(CASES)
    for name in settings.only:
        variable, file, feet, sole, parts = ROBOTS[name]
        source = Path(os.environ.get(variable, "")) / file
        if not source.exists():
            refusals.append(f"{name}: not judged; {variable} names no folder with {file}")
            continue
        description, cases = folder / name, folder / f"{name}-{'soft' if settings.soft else 'usual'}"
        if not description.exists():
            tt.describe_robot(source, feet=feet, sole=sole, out=description)
        robot = tt.load_robot(description / "robot.toml")
        still = tuple(j for j in joint_names(robot.model) if any(part in j for part in parts.split()))
        first = settings.seed + 1000 * list(ROBOTS).index(name)
        seeds = range(first, first + count)
        calls = [(robot, seed, still, settings.soft, cases / str(seed)) for seed in seeds]
        try:
            settings.parallel(name, carry_out, calls)
        except KeyboardInterrupt:
            yield "Stopped.\n"
        said = [
            (path, json.loads(path.read_bytes()))
            for path in sorted(cases.glob("*/*.json"))
            if path.stem in STEPS and int(path.parent.name) < first + count
        ]
        hits = [[hit for _, one in said for hit in np.ravel(one.get(column, []))] for column in JUDGED]
        judged.append(row(name, *(share(int(sum(one)), len(one)) for one in hits)))
        for step in STEPS:
            if seconds := [one["seconds"] for path, one in said if path.stem == step]:
                middle = f"median {np.median(seconds):.0f} s of CPU"
                spent.append(f"{name}, {step}: {len(seconds)} cases, {middle}")
        failed = [(path.parent.name, one["failed"]) for path, one in said if "failed" in one]
        refusals += [f"{name}, {seed}: {text}" for seed, text in failed]
    yield header("robot", *JUDGED)
    yield from judged
    yield "\n" + "\n".join(f"- {text}" for text in spent + refusals)

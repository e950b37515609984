"""Judge the tool on simulated records like a real humanoid's on one foot, whose truth is known (hours).

Each has other masses (10 %), a rocking sole, cross-talk of 1 %, and a wrench in axes, about a point and with a
sign that nobody states. The robots' files are not ours; docs/studies/real-robots.md says where they are from.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import tulip_testbed as tt
from studies.real_robots.records import true_spec, write_record
from studies.runner import Settings, header, row, share
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.sim.robot import Robot, joint_names

ICUB, OTHERS = "TULIP_ICUB_YOGA", "TULIP_PUBLISHED_ROBOTS"  # variables of the environment that name folders
ROBOTS = {  # a folder's variable and a file there; feet and soles that it does not tell; parts that no log has
    "icub": (ICUB, "iCubGenova02.urdf", ("r_ankle_2", "l_ankle_2"), (0.14, 0.06, 0.09, 0.0645), "wrist neck"),
    "g1": (OTHERS, "g1_29dof.urdf", None, None, ""),
    "talos": (OTHERS, "talos.urdf", ("leg_right_6_link", "leg_left_6_link"), (0.1, 0.1, 0.13, 0.107), ""),
}
SETTINGS = Settings(seed=40000, only=tuple(ROBOTS))
CASES, WORSE = 30, 1.05
AXES = {"sensor": "sensor", "base": "base link", "world": "world"}
SIGNS = {1: "of the ground on the robot", -1: "of the robot on the ground"}
ROCKING, CROSS_TALK = {"foot-compliance", "sole-compliance"}, {"wrench-crosstalk"}
ALSO_TRUE = {"wrench-rotation", "wrench-origin", "wrench-zero", "encoder-offset"}
JUDGED = ("frame right", "beats CAD with offset", "worse by 5 %", "rocking", "cross-talk", "false name")


@one_blas_thread
def case(robot: Robot, seed: int, not_logged: tuple[str, ...]) -> dict[str, Any]:
    """Return what is true of the tool on one record, by column; a column that it did not come to is missing."""
    said: dict[str, Any] = {"failed": []}
    with TemporaryDirectory() as folder:
        record, measured = Path(folder) / "record", Path(folder) / "measured"
        truth = write_record(robot, seed, record, not_logged)

        def audit() -> None:
            found = tt.import_table(
                record / "series.csv", robot, out=measured, map=[str(record / "MAP.toml")]
            )
            told = {c["what"]: c["hypothesis"] for c in found.to_json()["conventions"] if c["applied"]}
            axes, sign = (told.get(f"{what} of the wrench", "") for what in ("axes", "sign"))
            published = "published" in axes or truth.frame != "base" or robot.model.body_quat[1, 0] == 1
            said["frame right"] = AXES[truth.frame] in axes and published and sign == SIGNS[truth.sign]
            if found.folder is None:
                raise InputError(f"no folder: {found.problems[0]}")

        def predict() -> None:
            models = [m for m in tt.predict(measured, robot).to_json()["models"] if m["split"] == "halves"]
            rms = {m["name"]: np.hypot(m["rms_mm"]["x"], m["rms_mm"]["y"]) for m in models}
            ratio = rms["identified with corrections"] / rms["CAD with offset"]
            said["beats CAD with offset"], said["worse by 5 %"] = bool(ratio < 1), bool(ratio > WORSE)

        def discover() -> None:
            found = tt.discover(measured, robot, check=False)
            adopted = {one.effect.name for one in found.adopted}
            named = adopted | {one.instance.effect.name for one in found.explanations}
            named |= {one.family.effect.name for one in found.families}
            said["rocking"], said["cross-talk"] = bool(named & ROCKING), bool(named & CROSS_TALK)
            said["false name"] = not adopted <= ROCKING | CROSS_TALK | ALSO_TRUE

        def identify() -> None:
            found, model = tt.identify(measured, robot), true_spec(robot, truth).compile()
            of = base_parameters(robot, model, found.parameters.support)
            true, ends = of.values(standard_parameters(model)), [found[n].interval95 for n in of.names]
            said["inside"] = [low <= value <= high for value, (low, high) in zip(true, ends, strict=True)]

        for step in (audit, predict, discover, identify):
            try:
                step()
            except (InputError, KeyError) as error:  # a refusal, or a key that the document lacks
                said["failed"].append(f"{step.__name__}: {type(error).__name__}: {error}"[:200])
                if step is audit:
                    break
    return said


def study(settings: Settings) -> Iterator[str]:
    """Yield a table with a row for each robot, and where the tool refused."""
    yield header("robot", *JUDGED, "coverage of 95 %")
    refusals = []
    for name in settings.only:
        variable, file, feet, sole, parts = ROBOTS[name]
        folder, source = settings.folder("real-robots") / name, Path(os.environ.get(variable, "")) / file
        if not source.exists():
            refusals.append(f"{name}: not judged; {variable} names no folder with {file}")
            continue
        if not folder.exists():
            tt.describe_robot(source, feet=feet, sole=sole, out=folder)
        robot = tt.load_robot(folder / "robot.toml")
        still = tuple(j for j in joint_names(robot.model) if any(part in j for part in parts.split()))
        seeds = [settings.seed + 1000 * list(ROBOTS).index(name) + k for k in range(settings.count(CASES))]
        said = settings.parallel(name, case, [(robot, seed, still) for seed in seeds])
        counts = [[one[column] for one in said if column in one] for column in JUDGED]
        counts.append([each for one in said for each in one.get("inside", ())])
        yield row(name, *(share(sum(values), len(values)) for values in counts))
        refusals += [
            f"{name}, {s}: {text}" for s, one in zip(seeds, said, strict=True) for text in one["failed"]
        ]
    yield "\n" + "\n".join(f"- {text}" for text in refusals)

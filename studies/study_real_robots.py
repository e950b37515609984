"""Judge the tool on simulated records like a real humanoid's on one foot, whose truth is known (hours).

Every record has other masses (10 %), a rocking sole, cross-talk of 1 %, and a wrench written in axes, about a
point and with a sign that nobody states (`studies/real_robots/records.py`). It is imported, predicted, searched
and identified. The robots' files are not ours: a folder from an environment variable has them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import tulip_testbed as tt
from studies.real_robots.records import Truth, true_spec, write_record
from studies.runner import Settings, header, row, share
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.identification.base_parameters import (
    base_parameters,
    common_support,
    standard_parameters,
)
from tulip_testbed.sim.robot import Robot, joint_names

CASES, WORSE = 30, 1.05
WORDS = {"sensor": ("sensor", "sole", "foot"), "base": ("base", "root"), "world": ("world",)}
ROCKING, CROSS_TALK = {"foot-compliance", "sole-compliance"}, {"wrench-crosstalk"}
ALSO_TRUE = {"wrench-rotation", "wrench-origin", "wrench-zero", "encoder-offset"}


@dataclass(frozen=True)
class Subject:
    """A published robot: the variable that names its folder, its file there, what the file does not say."""

    variable: str
    file: str
    source: str
    feet: tuple[str, str] | None = None
    sole: tuple[float, float, float, float] | None = None
    not_logged: tuple[str, ...] = ()

    def prepared(self, folder: Path) -> Robot | None:
        """Return the robot, prepared once in a folder; None: its file is not here."""
        source = Path(os.environ.get(self.variable, "")) / self.file
        if not (folder / "robot.toml").exists():
            if self.variable not in os.environ or not source.exists():
                return None
            tt.describe_robot(source, feet=self.feet, sole=self.sole, out=folder)
        return tt.load_robot(folder / "robot.toml")


SUBJECTS = {
    "icub": Subject(
        *(
            "TULIP_ICUB_YOGA",
            "iCubGenova02.urdf",
            "github.com/robotology-playground/insitu-ft-analysis f290373",
        ),
        *(("r_ankle_2", "l_ankle_2"), (0.14, 0.06, 0.09, 0.0645), ("wrist", "neck")),
    ),
    "g1": Subject(
        *("TULIP_PUBLISHED_ROBOTS", "g1_29dof.urdf"),
        "github.com/unitreerobotics/unitree_rl_gym 276801e, resources/robots/g1_description",
    ),
    "talos": Subject(
        *("TULIP_PUBLISHED_ROBOTS", "talos.urdf"),
        "github.com/pal-robotics/talos_robot 221f916, talos_description/test/calibration/all_zero.urdf",
        *(("leg_right_6_link", "leg_left_6_link"), (0.1, 0.1, 0.13, 0.107)),
    ),
}
SETTINGS = Settings(seed=40000, only=tuple(SUBJECTS))


@dataclass
class Score:
    """What the tool made of one record; None: it did not come so far. failed: where, and its message."""

    frame: bool | None = None
    beats: bool | None = None
    worse: bool | None = None
    rocking: bool | None = None
    cross_talk: bool | None = None
    confident_and_wrong: bool | None = None
    inside: tuple[int, int] | None = None
    failed: tuple[str, ...] = ()


@one_blas_thread
def case(robot: Robot, folder: Path, seed: int, not_logged: tuple[str, ...]) -> Score:
    """Make a record and judge what the tool says of it."""
    record, score = folder / f"record-{seed}", Score()
    truth = write_record(robot, seed, record, not_logged)
    measured = folder / f"measured-{seed}"

    def imported() -> None:
        found = tt.import_table(record / "series.csv", robot, out=measured, map=[str(record / "MAP.toml")])
        if found.folder is None:
            raise InputError(found.problems[0])
        score.frame = frame_right(found.to_json()["conventions"], truth)

    def predicted() -> None:
        models = tt.predict(measured, robot).to_json()["models"]
        rms = {m["name"]: np.hypot(*m["rms_mm"].values()) for m in models if m["split"] == "halves"}
        ratio = rms["identified with corrections"] / rms["CAD with offset"]
        score.beats, score.worse = bool(ratio < 1), bool(ratio > WORSE)

    def discovered() -> None:
        found = tt.discover(measured, robot, check=False)
        adopted = {one.effect.name for one in found.adopted}
        told = adopted | {one.effect for one in found.explanations} | {one.name for one in found.families}
        score.rocking, score.cross_talk = bool(told & ROCKING), bool(told & CROSS_TALK)
        score.confident_and_wrong = not adopted <= ROCKING | CROSS_TALK | ALSO_TRUE

    def identified() -> None:
        found, model = tt.identify(measured, robot), true_spec(robot, truth).compile()
        parameters = base_parameters(robot, model, common_support(tt.read_measurements(measured).support))
        true = dict(zip(parameters.names, parameters.values(standard_parameters(model)), strict=True))
        ends = {name: found[name].interval95 for name in found}
        score.inside = (sum(ends[name][0] <= true[name] <= ends[name][1] for name in ends), len(ends))

    for step in (imported, predicted, discovered, identified):
        try:
            step()
        except (InputError, KeyError, AttributeError) as error:  # a key of the contract that is not there
            score.failed += (f"{step.__name__}: {type(error).__name__}: {error}".split("\n")[0],)
    return score


def frame_right(conventions: list[dict[str, Any]], truth: Truth) -> bool:
    """Return whether the audit applied the true axes to the left foot's wrench, and no others."""
    applied = [one["hypothesis"].lower() for one in conventions if one["applied"]]
    return any(word in text for text in applied for word in WORDS[truth.frame])


def study(settings: Settings) -> Iterator[str]:
    """Yield a table with a row for each robot, and where the tool refused."""
    columns = ("frame right", "beats CAD with offset", "worse by 5 %", "rocking", "cross-talk")
    yield header("robot", *columns, "wrong and confident", "coverage of 95 %")
    failed = []
    for number, name in enumerate(settings.only):
        subject, folder = SUBJECTS[name], settings.folder("real-robots") / name
        robot = subject.prepared(folder)
        if robot is None:
            failed.append(
                f"{name}: not measured; {subject.variable} names no folder with {subject.file} ({subject.source})"
            )
            continue
        still = tuple(j for j in joint_names(robot.model) if any(part in j for part in subject.not_logged))
        first = settings.seed + 1000 * number
        calls = [(robot, folder, first + k, still) for k in range(settings.count(CASES))]
        scores = settings.parallel(name, case, calls)
        keys = ("frame", "beats", "worse", "rocking", "cross_talk", "confident_and_wrong")
        counts = [[v for s in scores if (v := getattr(s, key)) is not None] for key in keys]
        inside = np.array([s.inside for s in scores if s.inside]).reshape(-1, 2).sum(axis=0)
        yield row(name, *(share(sum(v), len(v)) for v in counts), share(*map(int, inside)))
        failed += [f"{name}, seed {first + k}: {text}" for k, s in enumerate(scores) for text in s.failed]
    yield "\n" + "\n".join(f"- {text}" for text in failed)

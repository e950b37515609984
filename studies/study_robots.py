"""Take published robots through every command (docs/studies/robots.md; ten minutes a robot).

The robots' files are not part of this project. Those of `example-robot-data` come with the extra `robots`
(`make test-robots` installs it); for the others TULIP_ROBOTS is a folder with clones named OWNER+NAME.
A robot whose file is not there is left out, with its source.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import mujoco

from studies.runner import Settings, header, row
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.robot import Robot, load_robot

TULIP = [sys.executable, "-c", "from tulip_testbed.cli.entry import run; run()"]
PACKAGE = "example-robot-data 6.0.0"
UNITREE = "unitreerobotics/unitree_mujoco@c598f10"
BOOSTER = "BoosterRobotics/booster_gym@da396a0"
CASSIE = "osudrl/cassie-mujoco-sim@188d3d7"
COMMANDS = ("robot", "plan", "validate", "discover", "montecarlo", "view", "report")
MOST_SECONDS = 1800
NEIGHBOURS = 3  # links apart in the tree: closer ones overlap at their joints


@dataclass(frozen=True)
class Published:
    """A robot as it is published.

    Attributes:
        source: package or repository with its version.
        file: within it.
        stated: options of `tulip robot` for what the file does not hold.
    """

    name: str
    source: str
    file: str
    stated: tuple[str, ...] = ()


ROBOTS = (
    Published("G1", PACKAGE, "g1_description/urdf/g1_29dof_rev_1_0.urdf"),
    Published("iCub", PACKAGE, "icub_description/robots/icub_reduced.urdf"),
    Published("Romeo", PACKAGE, "romeo_description/urdf/romeo_small.urdf"),
    Published("TALOS", PACKAGE, "talos_data/robots/talos_full_v2.urdf"),
    Published(
        "simple_humanoid",
        PACKAGE,
        "simple_humanoid_description/urdf/simple_humanoid.urdf",
        # It has no geometry; the ankle's height is that of its SRDF.
        ("--feet", "r_ankle", "l_ankle", "--sole", "0.14", "0.10", "0.13", "0.105"),
    ),
    Published("G1 (MJCF)", UNITREE, "unitree_robots/g1/g1_29dof.xml"),
    Published("H1-2 (MJCF)", UNITREE, "unitree_robots/h1_2/h1_2_handless.xml"),
    Published("R1 (MJCF)", UNITREE, "unitree_robots/r1/R1_C++.xml"),
    Published("T1 (MJCF)", BOOSTER, "resources/T1/T1_serial.xml"),
    Published("H1 (MJCF)", UNITREE, "unitree_robots/h1/h1.xml"),
    Published("Cassie (MJCF)", CASSIE, "model/cassie.xml"),
)
SETTINGS = Settings(seed=1, only=tuple(one.name for one in ROBOTS))


def folder_of(robot: Published) -> Path | None:
    """Return the folder of a robot's source; None if it is not here."""
    if robot.source == PACKAGE:
        try:
            files = distribution("example-robot-data").files or ()
        except PackageNotFoundError:
            return None
        found = next((f for f in files if str(f).endswith(robot.file)), None)
        return None if found is None else Path(str(found.locate())[: -len(robot.file)])
    place = os.environ.get("TULIP_ROBOTS")
    name = robot.source.partition("@")[0].replace("/", "+")
    return Path(place) / name if place and (Path(place) / name / robot.file).is_file() else None


def study(settings: Settings) -> Iterator[str]:
    """Yield a row for every robot."""
    yield header("robot", "source", *COMMANDS, "penetration (mm)")
    refused = []
    for robot in ROBOTS:
        if robot.name not in settings.only:
            continue
        folder = folder_of(robot)
        if folder is None:
            refused.append(f"- {robot.name}: not here; {robot.source}, `{robot.file}`")
            continue
        cells, reason = taken_through(robot, folder / robot.file, settings)
        yield row(robot.name, robot.source, *cells)
        if reason:
            refused.append(f"- {robot.name}: {reason}")
    yield "\n" + "\n".join(refused)


def taken_through(robot: Published, file: Path, settings: Settings) -> tuple[list[str], str]:
    """Run all commands on a robot; return the table's cells and why one of them failed."""
    seed, runs = str(settings.seed), str(settings.count(50))
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        own = ("--robot", "robot/robot.toml")
        lines = {
            "robot": ("robot", str(file), *robot.stated, "--out", "robot"),
            "plan": (
                *("plan", "--placements", "16", "--postures-per-placement", "6", "--hops", "4"),
                *("--seed", seed, "--out", "plan", *own),
            ),
            "validate": ("validate", "plan", "--out", "run", "--seed", seed, *own),
            "discover": ("discover", "run/measurements", "--no-check", "--out", "found", *own),
            "montecarlo": ("montecarlo", "plan", "--runs", runs, "--seed", seed, "--out", "mc", *own),
            "view": ("view", "run", "--save", "run.rrd", *own),
            "report": ("report", "run", "--out", "run.html", *own),
        }
        cells, reason = [], ""
        for command, line in lines.items():
            began = time.perf_counter()
            try:
                done = subprocess.run(
                    [*TULIP, *line],
                    cwd=place,
                    capture_output=True,
                    text=True,
                    check=False,
                    timeout=MOST_SECONDS,
                )
                code, said = done.returncode, done.stderr.strip()
            except subprocess.TimeoutExpired:
                code, said = -1, f"more than {MOST_SECONDS} s"
            seconds = time.perf_counter() - began
            if code not in (0, 1):
                cells.append("no")
                last = said.splitlines()[-1].replace(f"{file.parent}/", "") if said else f"exit code {code}"
                reason = f"`tulip {command}`: {last}"
                break
            cells.append(f"{outcome(place, command)}{seconds:.0f} s")
        cells += [""] * (len(COMMANDS) - len(cells))
        plan = place / "plan"
        deepest = penetration(load_robot(place / "robot/robot.toml"), plan) if plan.exists() else None
        cells.append("" if deepest is None else f"{1e3 * deepest:.1f}")
    return cells, reason


def outcome(place: Path, command: str) -> str:
    """Return the verdict of a command, if it has one."""
    files = {
        "validate": "run/report.json",
        "discover": "found/discovery.json",
        "montecarlo": "mc/report.json",
    }
    if command not in files:
        return ""
    content = json.loads((place / files[command]).read_text())
    return f"{content.get('verdict', '')}, " if content.get("verdict") else ""


def penetration(robot: Robot, plan: Path) -> float:
    """Return the deepest penetration of two links in any posture of a plan [m], by MuJoCo's contacts.

    Links at most `NEIGHBOURS` joints apart, and those that touch in the keyframe `stand`, do not count. A
    link is what its collision geometry says, or all its geometry if it has none.
    """
    spec = mujoco.MjSpec.from_file(str(robot.model_file))
    corners = {f"{foot}_{corner}" for foot in robot.feet for corner in CORNERS}
    for body in spec.bodies[1:]:
        shapes = [geom for geom in body.geoms if geom.name not in corners]
        solid = [geom for geom in shapes if geom.contype or geom.conaffinity] or shapes
        for geom in body.geoms:
            geom.contype = geom.conaffinity = int(any(geom is one for one in solid))
            geom.margin = 0.0
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = model.key("stand").qpos

    def depths() -> dict[tuple[int, int], float]:
        mujoco.mj_forward(model, data)
        found: dict[tuple[int, int], float] = {}
        for contact in data.contact:
            pair = sorted(int(model.geom_bodyid[g]) for g in contact.geom)
            if apart(model, pair[0], pair[1]) > NEIGHBOURS:
                found[pair[0], pair[1]] = max(found.get((pair[0], pair[1]), 0.0), -float(contact.dist))
        return found

    touching, deepest = set(depths()), 0.0
    joints = [int(model.joint(name).qposadr[0]) for name in read_plan(plan, robot).joints]
    for angles in read_plan(plan, robot).joint_angles:
        data.qpos[joints] = angles
        deepest = max([deepest, *(depth for pair, depth in depths().items() if pair not in touching)])
    return deepest


def apart(model: mujoco.MjModel, first: int, second: int) -> int:
    """Return how many joints lie between two links."""

    def path(body: int) -> list[int]:
        return [body] if body == 0 else [body, *path(int(model.body_parentid[body]))]

    return len(set(path(first)) ^ set(path(second)))

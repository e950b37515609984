"""Run `tulip discover` on data as other programs write them (docs/studies/discovery-benchmark.md; fifteen minutes).

Every data set has its own noise, repeats and number of placements. Its table is CSV without hash, commands
and motor angles; its data sheet may lack the figures of cells, encoders or plates. Every second one has a
hidden effect, whose target and size are drawn from its prior. The study's folder keeps all cases as JSON.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from pyarrow import csv

from studies.runner import Settings, header, row, shipped_plan
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import write_text
from tulip_testbed.cli.main import main as tulip
from tulip_testbed.effects.instance import EffectInstance, injected
from tulip_testbed.effects.random_effects import draw_effect
from tulip_testbed.experiments.montecarlo.intervals import share
from tulip_testbed.measurements import Measurements, SensorSheet, write_measurements
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.sensors import PRESETS
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

SETTINGS = Settings(seed=4002)
DATA_SETS = 200
PLACEMENTS = (12, 31)
REPEATS = (0, 11)
LEAST_STANDING = 0.75
UNSAID = ("nothing", "cell_sd", "encoder_sd", "placement_sd")  # of the data sheet


def laboratory(robot: Robot, rng: np.random.Generator) -> Rig:
    """Draw a laboratory with encoders, cells and plates between those of the presets force-plate and wii."""
    fine, coarse = (dataclasses.asdict(PRESETS[name]) for name in ("force-plate", "wii"))
    parts = ("encoder", "motor", "cell", "placement", "mark", "weighed")
    at = dict(zip(parts, rng.uniform(size=len(parts)), strict=True))

    def between(name: str) -> Any:
        part = at.get(name.partition("_")[0])
        if part is None or name == "cell_gain":
            return fine[name]
        low, high = np.array(fine[name]), np.array(coarse[name])
        value = low ** (1 - part) * high**part
        return tuple(value.tolist()) if value.ndim else float(value)

    sensors = type(PRESETS["wii"])(**{name: between(name) for name in fine})
    rig = preset_rig("wii", robot)
    protocol = dataclasses.replace(rig.protocol, repeats=int(rng.integers(*REPEATS)))
    return dataclasses.replace(rig, sensors=sensors, protocol=protocol)


def written(measured: Measurements, unsaid: str, folder: Path) -> Path:
    """Write the measurements as another program may; return the folder."""
    sheet: SensorSheet = measured.sensors
    if unsaid != UNSAID[0]:
        sheet = dataclasses.replace(sheet, **{unsaid: None})
    bare = dataclasses.replace(measured, command=None, motor=None, sensors=sheet)
    write_measurements(folder / "parquet", bare)
    out = folder / "csv"
    out.mkdir()
    csv.write_csv(pq.read_table(folder / "parquet" / "postures.parquet"), out / "postures.csv")
    manifest = json.loads((folder / "parquet" / "manifest.json").read_text())
    (out / "manifest.json").write_text(json.dumps(manifest | {"tables": None}))
    return out


def one(seed: int, number: int) -> dict[str, Any] | None:
    """Simulate one data set and run the command on it; return None if the robot does not stand."""
    stream = np.random.SeedSequence((seed, number))
    drawing, noise = stream.spawn(2)
    rng, robot = np.random.default_rng(drawing), load_robot()
    plan, rig = shipped_plan(robot), laboratory(robot, rng)
    kept = rng.choice(np.unique(plan.placement), int(rng.integers(*PLACEMENTS)), replace=False)
    plan = plan.take(np.isin(plan.placement, kept))
    unsaid = UNSAID[rng.integers(len(UNSAID))]
    hidden: EffectInstance | None = None
    if number % 2:
        hidden = draw_effect(robot, np.unique(plan.placement).tolist(), rng, statics=True)
        rig = injected(rig, [hidden])
    try:
        measured = run_statics(solve_plan(rig, plan), [noise])[0].measurements
    except InputError:
        return None
    if len(np.unique(measured.posture)) < LEAST_STANDING * len(plan.posture):
        return None
    with tempfile.TemporaryDirectory() as name, io.StringIO() as out, io.StringIO() as err:
        folder = written(measured, unsaid, Path(name))
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = tulip(["discover", str(folder), "--out", f"{name}/run", "--no-check", "--json"])
        if code:
            raise RuntimeError(f"data set {number}: exit code {code}: {err.getvalue()}")
        document = json.loads(out.getvalue())
    return {"number": number, "unsaid": unsaid, "hidden": hidden and hidden.document(), "found": document}


def label(effect: dict[str, Any]) -> tuple[str, str | None, tuple[float, ...]]:
    """Return name, target and, of swapped cells, their numbers."""
    chosen = [p["value"] for p in effect["parameters"]] if effect["name"] == "swapped-cells" else []
    return effect["name"], effect["target"], tuple(sorted(chosen))


def right(case: dict[str, Any]) -> bool:
    return [label(e) for e in case["found"]["effects"]] == [label(case["hidden"])]


def in_set(case: dict[str, Any]) -> bool:
    among = [label(c) for c in case["found"]["candidates"]]
    return case["found"]["verdict"] != "unknown" and label(case["hidden"]) in among


def intervals(cases: Sequence[dict[str, Any]]) -> list[bool]:
    """Return whether each true size lies in its interval, for the effects that were named rightly."""
    return [
        found["low95"] <= true["value"] <= found["high95"]
        for case in cases
        if right(case)
        for found, true in zip(
            case["found"]["effects"][0]["parameters"], case["hidden"]["parameters"], strict=True
        )
        if found["low95"] is not None
    ]


def figure(name: str, hits: Sequence[bool]) -> str:
    if not hits:
        return row(name, "", 0)
    found = share(np.array([sum(hits)]), len(hits), 0.95)
    low, high = found.interval[:, 0]
    return row(name, f"{found.value[0]:.3f} ({low:.3f} to {high:.3f})", len(hits))


def gap(case: dict[str, Any]) -> bool:
    return case["found"]["verdict"] != "none"


def named(case: dict[str, Any]) -> bool:
    return case["found"]["verdict"] == "named"


def study(settings: Settings) -> Iterator[str]:
    """Yield a table of figures."""
    numbers = range(settings.count(DATA_SETS))
    every = settings.parallel("data sets", one, ((settings.seed, number) for number in numbers))
    cases = [case for case in every if case is not None]
    write_text(settings.folder("foreign") / "cases.json", json.dumps(cases))
    null = [case for case in cases if not case["hidden"]]
    true = [case for case in cases if case["hidden"]]
    yield header("figure", "value (95 % interval)", "cases")
    yield figure("false alarms", [gap(c) for c in null])
    yield figure("a gap seen, sizes drawn from the prior", [gap(c) for c in true])
    yield figure("true effect in the set, of gaps seen", [in_set(c) for c in true if gap(c)])
    yield figure("right, of what was named", [right(c) for c in true if named(c)])
    yield figure("one wrong name, confidently, of all effects", [named(c) and not right(c) for c in true])
    yield figure("95 % intervals of the size hold it", intervals(true))
    yield f"\n{len(every) - len(cases)} laboratories of {len(every)} in which the robot does not stand."

"""Draw the README's pictures: the robot on its plates, the rerun window, the report.

Needs libosmesa6, mesa-vulkan-drivers and chromium.
"""

from __future__ import annotations

import io
import tempfile
import time
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
from PIL import Image

from experiments.cli import main as tulip
from experiments.report.rendering import render
from experiments.scenario import DEFAULT_PLAN
from sim.laboratory import boards_under
from sim.measurements import read_plan
from sim.model import load_model, load_robot
from sim.rig import preset_rig
from tools.looking import browse, headless_viewer

DOCS = Path(__file__).resolve().parent.parent / "docs"
ROWS = (2, 26, 58, 121)
SEED = "1"
VIEW_ROW = 75
WINDOW, PAGE = (1600, 1000), (1100, 1500)
DRAWN_BY = 6.0  # s, until rerun's notes at its start are gone


def main() -> None:
    _save(DOCS / "postures.png", _postures())
    with tempfile.TemporaryDirectory() as scratch:
        run = Path(scratch) / "first"
        with redirect_stdout(io.StringIO()):
            tulip(["validate", "--seed", SEED, "--out", str(run), "--json"])
        _save(DOCS / "view.png", _window(run, Path(scratch)))
        _save(DOCS / "report.png", _report(run, Path(scratch)))


def _postures() -> Image.Image:
    robot = load_robot()
    plan = read_plan(DEFAULT_PLAN, robot, load_model(robot))
    rows = list(ROWS)
    boards = boards_under(preset_rig("ideal", robot), plan.swing_pose[rows])
    frames = [Image.open(io.BytesIO(png)) for png in render(robot, plan.joint_angles[rows], boards)]
    return Image.fromarray(np.hstack([np.asarray(frame.convert("RGB")) for frame in frames]))


def _window(run: Path, scratch: Path) -> Image.Image:
    view, picture = scratch / "view.rrd", scratch / "view.png"
    tulip(["view", str(run), "--save", str(view)])
    with headless_viewer(view, WINDOW) as viewer:
        viewer.set_time("posture", sequence=VIEW_ROW, play_state="paused")
        time.sleep(DRAWN_BY)
        viewer.save_screenshot(str(picture))
    return Image.open(picture).convert("RGB")


def _report(run: Path, scratch: Path) -> Image.Image:
    page, picture = scratch / "first.html", scratch / "report.png"
    tulip(["report", str(run), "--out", str(page)])
    seen = browse(page, picture, PAGE)
    assert not seen.complaints, seen.complaints
    return Image.open(picture).convert("RGB").crop((0, 0, *PAGE))


def _save(target: Path, picture: Image.Image) -> None:
    picture.quantize(256).save(target, optimize=True)
    print(target)


if __name__ == "__main__":
    main()

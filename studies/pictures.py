"""Draw the pictures of the docs: robots on their plates, rerun windows, reports of a run and of a discovery.

Needs libosmesa6, mesa-vulkan-drivers and chromium.
"""

import io
import tempfile
import time
from contextlib import chdir, redirect_stdout
from pathlib import Path

import numpy as np
from PIL import Image

from tests.looking import browse, headless_viewer
from tulip_testbed.cli.main import main as tulip
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN
from tulip_testbed.rendering import rendered
from tulip_testbed.sim.plan_folder import read_plan
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.scene import boards_under

PICTURES = Path(__file__).resolve().parent.parent / "docs" / "pictures"
ROWS = (2, 26, 58, 121)
SEED = "1"
EFFECT = "encoder-offset:right_ankle_roll=0.01"
VIEW_ROW = 75
FRAME = (360, 480)  # pixels, of a posture
WINDOW, PAGE = (1600, 1000), (1100, 1500)
DRAWN_BY = 6.0  # s, until rerun's notes at its start are gone


def main() -> None:
    _save(PICTURES / "postures.png", _postures())
    with tempfile.TemporaryDirectory() as scratch:
        run = Path(scratch) / "first"
        with redirect_stdout(io.StringIO()):
            tulip(["validate", "--seed", SEED, "--out", str(run), "--json"])
        found = _discovery(Path(scratch))
        for name, folder in (("", run), ("discovery-", found)):
            _save(PICTURES / f"{name}view.png", _window(folder, Path(scratch)))
            _save(PICTURES / f"{name}report.png", _report(folder, Path(scratch)))


def _postures() -> Image.Image:
    robot = load_robot()
    plan = read_plan(DEFAULT_PLAN, robot)
    rows = list(ROWS)
    boards = boards_under(preset_rig("ideal", robot), plan.foot_poses[rows])
    return Image.fromarray(
        np.hstack([*rendered(robot, plan.joint_angles[rows], plan.support[rows], boards, *FRAME)])
    )


def _discovery(scratch: Path) -> Path:
    hidden = ["--sensors", "force-plate", "--seed", SEED, "--effects", EFFECT, "--truth", "truth.json"]
    with chdir(scratch), redirect_stdout(io.StringIO()):
        tulip(["simulate", "--engine", "statics", *hidden, "--out", "hidden", "--json"])
        tulip(["discover", "hidden", "--no-check", "--out", "found", "--json"])
    return scratch / "found"


def _window(run: Path, scratch: Path) -> Image.Image:
    view, picture = scratch / f"{run.name}.rrd", scratch / f"{run.name}-view.png"
    tulip(["view", str(run), "--save", str(view)])
    with headless_viewer(view, WINDOW) as viewer:
        viewer.set_time("posture", sequence=VIEW_ROW, play_state="paused")
        time.sleep(DRAWN_BY)
        viewer.save_screenshot(str(picture))
    return Image.open(picture).convert("RGB")


def _report(run: Path, scratch: Path) -> Image.Image:
    page, picture = scratch / f"{run.name}.html", scratch / f"{run.name}-report.png"
    tulip(["report", str(run), "--out", str(page)])
    observed = browse(page, picture, PAGE)
    assert not observed.complaints, observed.complaints
    return Image.open(picture).convert("RGB").crop((0, 0, *PAGE))


def _save(target: Path, picture: Image.Image) -> None:
    picture.quantize(256).save(target, optimize=True)
    print(target)


if __name__ == "__main__":
    main()

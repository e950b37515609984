"""Decide whether this machine can draw, by drawing: rerun by Vulkan, MuJoCo by OpenGL, Chromium."""

import os
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from PIL import Image

from tests.looking import browse, headless_viewer

PACKAGES = {
    "vulkan": "mesa-vulkan-drivers",
    "opengl": "libegl1 libgl1-mesa-dri libosmesa6",
    "chromium": "chromium",
}
WHEN = ("possible", "always", "never")
BALL = '<mujoco><worldbody><light pos="0 0 3"/><geom size="1" rgba="1 0 0 1"/></worldbody></mujoco>'
RENDER = f"""
import mujoco
model = mujoco.MjModel.from_xml_string({BALL!r})
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(data)
    assert renderer.render().max() > 100
"""


def draws_with(program: str) -> pytest.MarkDecorator:
    """Mark a test that draws with "vulkan", "opengl" or "chromium": it is skipped where that cannot draw."""
    return pytest.mark.draws(program)


@cache
def obstacle_to(program: str) -> str:
    """Draw something small; return what prevents it and the packages to install, or nothing."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        try:
            {"vulkan": _by_vulkan, "opengl": _by_opengl, "chromium": _by_chromium}[program](Path(folder))
        except (OSError, RuntimeError, ValueError, subprocess.SubprocessError) as error:
            said = " ".join(str(error).split())[-200:]
            return f"cannot draw with {program} ({said}); on Debian: apt-get install {PACKAGES[program]}"
    return ""


def decide(program: str, obstacle: str, when: str) -> None:
    """Skip the test at an obstacle; fail it if `when` is "always", or if `when` is "never" and it draws."""
    if when == "never" and not obstacle:
        pytest.fail(f"drew with {program}, although it was made unreachable")
    if when == "always" and obstacle:
        pytest.fail(obstacle)
    if obstacle:
        pytest.skip(obstacle)


def unreachable(folder: Path) -> dict[str, str]:
    """Return the environment in which no process finds a driver or Chromium.

    Args:
        folder: where empty files take the place of OSMesa's library, which no variable names.
    """
    for version in ("", *(f".{k}" for k in range(10))):
        (folder / f"libOSMesa.so{version}").touch()
    nothing = str(folder / "nothing")
    drivers = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "__EGL_VENDOR_LIBRARY_FILENAMES")
    found = {"LD_LIBRARY_PATH": str(folder), "PATH": str(Path(sys.executable).parent)}
    return found | dict.fromkeys(drivers, nothing)


def _by_vulkan(folder: Path) -> None:
    recording = rr.RecordingStream("ball")
    recording.save(folder / "ball.rrd")
    recording.log("ball", rr.Points3D([[0, 0, 0]], radii=1.0))
    recording.disconnect()
    with headless_viewer(folder / "ball.rrd", (300, 200)) as viewer:
        viewer.save_screenshot(str(folder / "ball.png"))
    _has_colours(folder / "ball.png")


def _by_opengl(folder: Path) -> None:
    said = ""
    for platform in ("egl", "osmesa"):
        environment = os.environ | {"MUJOCO_GL": platform, "PYOPENGL_PLATFORM": platform}
        done = subprocess.run(
            [sys.executable, "-c", RENDER],
            env=environment,
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=120,
        )
        if done.returncode == 0:
            return
        said = done.stderr
    raise RuntimeError(said.strip().rsplit("\n", 1)[-1])


def _by_chromium(folder: Path) -> None:
    page = folder / "page.html"
    page.write_text("<body data-drawn='yes'><h1>drawn</h1></body>")
    browse(page, folder / "page.png", (300, 200))
    _has_colours(folder / "page.png")


def _has_colours(picture: Path) -> None:
    if len(np.unique(np.asarray(Image.open(picture).convert("L")))) < 2:
        raise RuntimeError("the picture is blank")

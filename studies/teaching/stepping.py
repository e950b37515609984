"""Animate the robot on its way through postures of the shipped plan, with forces and centre of pressure.

Between the postures the torso moves on a line while the feet stay in place; the forces are those of the
static equilibrium of every image, by the static laboratory without noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.patches import Polygon
from PIL import Image

from studies.improve.output import BLUE, GREEN, ORANGE, RED
from studies.runner import shipped_plan
from studies.teaching.renderer import Scenes, rendered_scenes
from studies.teaching.style import GREY, card, picture_of
from tulip_testbed.discovery.refit import without_noise
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import center
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.path import ClosedChain
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import load_robot
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

PLACEMENTS, EACH = (2, 12), 4  # of the shipped plan, and postures of each
IMAGES = 9  # of a movement
MOVING, HELD, PUT_DOWN = 70, 700, 1000  # ms that an image stays
VIEW, SIZE = (380, 440), (640, 440)  # pixels, of the robot and of all
SEED = 11  # of dry friction, the one thing that is left to chance
PIXELS = 96  # an inch
MOST = 3_000_000  # bytes


@dataclass(frozen=True, eq=False)
class Way:
    """The images of the film, in order.

    Attributes:
        plan: joint angles of every image as a plan.
        posture: number of the posture that the image shows or leads to, from 1, (k,).
        held: whether the image shows a planned posture, (k,) bool.
        duration: of the image [ms], (k,).
    """

    plan: PosturePlan
    posture: np.ndarray
    held: np.ndarray
    duration: np.ndarray


def way_through(plan: PosturePlan, chain: ClosedChain, images: int = IMAGES) -> Way:
    """Return planned postures with `images` images on the way from one to the next of a placement."""
    angles, torques, row, held, duration = [], [], [], [], []
    for k in range(len(plan)):
        new = k == 0 or plan.placement[k] != plan.placement[k - 1]
        if not new:
            between = chain.path(plan.joint_angles[k - 1], plan.joint_angles[k], images + 1)[:-1]
            part = np.linspace(0, 1, images + 2)[1:-1, None]
            angles += list(between)
            torques += list(plan.feed_forward[k - 1] * (1 - part) + plan.feed_forward[k] * part)
            row, held, duration = row + [k] * images, held + [False] * images, duration + [MOVING] * images
        angles.append(plan.joint_angles[k])
        torques.append(plan.feed_forward[k])
        row, held, duration = [*row, k], [*held, True], [*duration, PUT_DOWN if new else HELD]
    whole = replace(
        plan.take(np.array(row)),
        joint_angles=np.array(angles),
        posture=np.arange(1, len(row) + 1),
        torques=np.array(torques),
    )
    return Way(whole, np.array(row) + 1, np.array(held), np.array(duration))


def film(path: Path) -> Path:
    """Write the animation."""
    robot = load_robot()
    plan = shipped_plan(robot)
    rows = np.concatenate([np.flatnonzero(plan.placement == number)[:EACH] for number in PLACEMENTS])
    way = way_through(plan.take(rows), ClosedChain(robot.model, robot))
    rig = without_noise(preset_rig("ideal", robot))
    (run,) = run_statics(solve_plan(rig, way.plan), [np.random.SeedSequence(SEED)], all_solved=True)
    if len(run.measurements) != len(way.plan):
        raise RuntimeError(f"found {len(run.measurements)} equilibria, expected {len(way.plan)}")
    seen = observe(run.measurements, nominal_robot(robot))
    scenes = Scenes(
        angles=seen.joint_angles,
        plates=seen.plate_poses,
        cells=seen.cell_places,
        forces=seen.cell_forces,
        pressure=center(seen),
        center=seen.center,
        size=np.array(VIEW),
    )
    images = [_joined(image, _from_above(seen, way, k)) for k, image in enumerate(rendered_scenes(scenes))]
    images[0].save(
        path,
        save_all=True,
        append_images=images[1:],
        duration=way.duration.tolist(),
        loop=0,
        quality=85,
        method=6,
        minimize_size=True,
    )
    return path


def _joined(robot: np.ndarray, above: Image.Image) -> Image.Image:
    whole = Image.new("RGB", SIZE, "white")
    whole.paste(Image.fromarray(robot), (0, 0))
    whole.paste(above, (VIEW[0], 0))
    return whole


def _from_above(seen: Observation, way: Way, k: int) -> Image.Image:
    """Draw the plates from above, with the centre of pressure now and at the postures before."""
    width, height = (SIZE[0] - VIEW[0]) / PIXELS, SIZE[1] / PIXELS
    with card(1, 1, width, height) as (figure, axes):
        ax, pressure = axes[0, 0], center(seen)
        ax.grid(False)
        for pose, name in zip(seen.plate_poses[k], ("right plate", "left plate"), strict=True):
            plate = _in_picture(_outline(seen, pose))
            ax.add_patch(Polygon(plate, facecolor="#e4e4e4", edgecolor=GREY))
            ax.text(plate[:, 0].mean(), plate[:, 1].max() + 0.02, name, ha="center", fontsize=8)
        for sole in seen.nominal.soles_in_base(seen.joint_angles[k : k + 1])[0]:
            around = sole[np.argsort(np.arctan2(*(sole - sole.mean(axis=0)).T))]
            ax.add_patch(Polygon(_in_picture(around), facecolor="#bdbdbd", edgecolor=GREY))
        earlier = np.flatnonzero(way.held[:k] & (way.plan.placement[:k] == way.plan.placement[k]))
        ax.plot(*_in_picture(pressure[earlier]).T, "o", color=ORANGE, markersize=6, markeredgecolor="black")
        ax.plot(*_in_picture(pressure[k]), "o", color=RED, markersize=10, markeredgecolor="black")
        ax.set(xlim=(-0.29, 0.45), ylim=(-0.64, 0.62), aspect="equal", xticks=[], yticks=[])
        ax.spines[:].set_visible(False)
        number = int(way.posture[k])
        say = {"ha": "left", "fontsize": 9.5, "transform": ax.transAxes}
        ax.text(0.02, 0.97, f"Posture {number} of {way.posture.max()}", fontweight="bold", va="top", **say)
        ax.text(0.02, 0.91, _place_text(way, k), va="top", **say)
        ax.text(0.5, 0.245, "▼ forward", va="center", **(say | {"ha": "center", "fontsize": 8}))
        for line, (sign, colour, text) in enumerate(
            [
                ("↑", BLUE, "forces on the load cells"),
                ("●", RED, "centre of pressure (CoP)"),
                ("●", ORANGE, "CoP of earlier postures"),
                ("●", GREEN, "centre of mass"),
            ]
        ):
            ax.text(0.02, 0.19 - 0.055 * line, sign, color=colour, va="center", **say)
            ax.text(0.10, 0.19 - 0.055 * line, text, va="center", **say)
        return picture_of(figure, PIXELS)


def _place_text(way: Way, k: int) -> str:
    first = way.plan.placement[k] == way.plan.placement[0]
    return "first placement" if first else "left plate moved"


def _outline(seen: Observation, pose: np.ndarray) -> np.ndarray:
    """Return the corners of the rectangle of a plate's cells, (4, 2) [m]."""
    x, y, yaw = pose
    places = seen.cells[0]
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    around = places[np.argsort(np.arctan2(*places.T))]
    return around @ turn.T + [x, y]


def _in_picture(place: np.ndarray) -> np.ndarray:
    """Return places as seen from before the robot: forward (x) down, left (y) on the right, (..., 2)."""
    return np.stack([place[..., 1], -place[..., 0]], axis=-1)

"""A plate's board rocks on its diagonal: its foot at one cell is too short by a gap.

A rigid board stands on three feet: the two next to the short one, and of the short one and its opposite that
on the side of the diagonal where the load lies. With the load at the short foot it tips about the diagonal
by the gap over the foot's distance from the diagonal; otherwise it is level. The robot's foot tilts with
the board, and the cell that hangs in the air bears nothing. The size, a few tenths of a millimetre as of
feet that nobody adjusted, is assumed.

In closed legs the load may come to lie on the diagonal, the more often the wider the gap. Then the board
rests anywhere in between. The cells show within their noise on which side the load lies: the prediction is
the mean of where the board rests, and `_unsure` the spread about it.

`lifted-corner` is the other way round: there something lies under a sole, the board is level and the foot
rocks.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.special import ndtr

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.targets import CELL_NAMES
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.sim.rig import Rig

BALANCED = 0.0005  # m, s.d. of the strip about the diagonal in which a board may rest in between, assumed


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    plate, _, corner = target.partition(".")

    def edit(spec: mujoco.MjSpec) -> None:
        cell = spec.geom(f"{plate}_plate_{corner}")
        cell.pos = cell.pos + np.array([0.0, 0.0, values[0]])

    return edited(rig, edit)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return _tipped(observed, target, values, 0.0)


def _unsure(observed: Observation, target: str, values: Values) -> Observation:
    return _tipped(observed, target, values, 1.0)


def _tipped(observed: Observation, target: str, values: Values, spread: float) -> Observation:
    """Return the observation with a level board.

    Args:
        spread: s.d. by which the board is more tipped than on average.
    """
    plate, _, corner = target.partition(".")
    side = PLATES.index(plate)
    short, left, _, right = np.roll(observed.cells[side], -CORNERS.index(corner), axis=0)
    along = (right - left) / np.linalg.norm(right - left)
    across = np.array([-along[1], along[0]])
    away = (short - left) @ across  # of the short foot from the diagonal
    forces = observed.cell_forces.reshape(-1, 2, 4)[:, side]
    load = np.maximum(forces.sum(axis=1) + 4 * observed.board_share[side], 1e-6)
    levers = (observed.cells[side] - left) @ across
    towards = forces @ levers / load * np.sign(away)  # the board's own weight lies on the diagonal
    noise = observed.cell_sd * np.linalg.norm(levers) / load
    share = ndtr(towards / np.hypot(BALANCED, noise))
    tipped = (share + spread * np.sqrt(share * (1 - share))) * values[0] / away
    yaw = observed.plate_poses[:, side, 2]
    c, s = np.cos(yaw), np.sin(yaw)
    # Downhill direction of the board in the base frame times its slope; it rises the other way.
    slope = tipped[:, None] * np.column_stack([c * across[0] - s * across[1], s * across[0] + c * across[1]])
    pivot = observed.plate_poses[:, side, :2] + np.column_stack(
        [c * left[0] - s * left[1], s * left[0] + c * left[1]]
    )
    if side == 0:
        tilt = np.column_stack([-slope[:, 1], slope[:, 0]])
        rise = (slope * pivot).sum(axis=1)
        return observed.changed(
            stance_tilt=observed.stance_tilt + tilt, swing_rise=observed.swing_rise - rise
        )
    place, turn = observed.swing_sole
    yaw = np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    tilt = np.column_stack([s * slope[:, 0] - c * slope[:, 1], c * slope[:, 0] + s * slope[:, 1]])
    rise = -(slope * (place[:, :2] - pivot)).sum(axis=1)
    return observed.changed(swing_tilt=observed.swing_tilt + tilt, swing_rise=observed.swing_rise + rise)


EFFECT = Effect(
    name="rocking",
    sentence="A plate's board rocks on its diagonal, because its foot at this cell is too short by this gap.",
    parameters=(Parameter("gap", "m", prior=0.0003, positive=True),),
    mechanism=Physics(_inject, _predict, _unsure),
    words="The board rocks: its foot at the {target} cell is too short by {0}.",
    targets=CELL_NAMES,
    instrument="cells",
)

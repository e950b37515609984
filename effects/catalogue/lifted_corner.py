"""Something lies under a corner of a foot's sole: a cable, a stone or a bent edge.

The foot stands on three corners: that one, the opposite one, and of the other two the one on the same side
of the diagonal as the centre of pressure. So it is tilted about one of two edges. In closed legs the foot
usually rocks until its centre of pressure lies on the diagonal and then rests anywhere in between. The cells
show within their noise on which side it lies: the prediction is the mean of where the foot rests, and
`_unsure` the spread about it.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
from scipy.special import ndtr

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import always, edited
from tulip_testbed.effects.targets import FOOT_CORNERS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements.cells import CORNERS
from tulip_testbed.sim.rig import Rig

ROCKING = 0.001  # m, s.d. of the strip about the diagonal in which a foot may rest in between, assumed


def _inject(rig: Rig, target: str, values: Values) -> Rig:
    geom, thickness = target.replace(".", "_"), values[0]

    def edit(spec: mujoco.MjSpec) -> None:
        corner = spec.geom(geom)
        corner.pos = corner.pos - np.array([0.0, 0.0, thickness])

    def tolerant(one: Rig) -> Rig:
        limit = one.protocol.lift_limit + 2 * thickness
        return replace(one, protocol=replace(one.protocol, lift_limit=limit))

    return always(edited(rig, edit), tolerant)


def _predict(observed: Observation, target: str, values: Values) -> Observation:
    return _level(observed, target, values, 0.0)


def _unsure(observed: Observation, target: str, values: Values) -> Observation:
    return _level(observed, target, values, 1.0)


def _level(observed: Observation, target: str, values: Values, spread: float) -> Observation:
    """Return the observation with a flat foot.

    Args:
        spread: s.d. by which the foot is tilted more to one side than on average.
    """
    foot, _, corner = target.partition(".")
    side = observed.nominal.robot.feet.index(foot)
    soles, number = observed.nominal.soles[side], CORNERS.index(corner)
    tilt, rise = _stand(soles, number, _center(observed, side), _noise(observed, side), spread)
    tilt, rise = values[0] * tilt, values[0] * rise
    if side == 0:
        return observed.changed(
            stance_tilt=observed.stance_tilt + tilt, swing_rise=observed.swing_rise - rise
        )
    return observed.changed(swing_tilt=observed.swing_tilt + tilt, swing_rise=observed.swing_rise + rise)


def _center(observed: Observation, side: int) -> np.ndarray:
    """Return the centre of pressure under a foot from its sole point, in the foot's axes, (m, 2) [m]."""
    down = observed.foot_loads[0][:, side]
    return observed.sole_loads[:, side] / np.where(np.abs(down) > 1e-6, down, np.inf)[:, None]


def _noise(observed: Observation, side: int) -> np.ndarray:
    """Return the s.d. of the centre of pressure under a foot by the noise of the cells, (m,) [m]."""
    down = np.maximum(observed.foot_loads[0][:, side], 1e-6)
    reach = np.linalg.norm(observed.cells[side]) / np.sqrt(2)  # of the four cells together, along one axis
    return observed.cell_sd * reach / down


def _stand(
    corners: np.ndarray, lifted: int, center: np.ndarray, noise: np.ndarray, spread: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the attitude of a foot per thickness under one of its corners.

    Args:
        corners: of the sole from the sole point, (4, 2) [m].
        lifted: index of the corner.
        center: centre of pressure from the sole point, (m, 2) [m]. noise: its s.d., (m,) [m].
        spread: s.d. by which it stands more on one side than on average.

    Returns:
        Roll and pitch, (m, 2) [rad/m], and rise of the sole point, (m,).
    """
    opposite, *between = ((lifted + k) % 4 for k in (2, 1, 3))
    along = corners[opposite] - corners[lifted]
    planes = []
    for third in between:
        points = np.column_stack([corners[[lifted, third, opposite]], np.ones(3)])
        planes.append(np.linalg.solve(points, [1.0, 0.0, 0.0]))  # height over the ground = a x + b y + c
    normal = np.array([-along[1], along[0]])
    normal = normal * np.sign((corners[between[0]] - corners[lifted]) @ normal) / np.linalg.norm(normal)
    share = ndtr((center - corners[lifted]) @ normal / np.hypot(ROCKING, noise))
    share = share + spread * np.sqrt(share * (1 - share))
    a, b, c = np.outer(planes[0], share) + np.outer(planes[1], 1 - share)
    return np.column_stack([b, -a]), c


EFFECT = Effect(
    name="lifted-corner",
    sentence="Something of this thickness lies under a corner of a foot's sole.",
    parameters=(Parameter("thickness", "m", prior=0.001, positive=True),),
    mechanism=Physics(_inject, _predict, _unsure),
    words="Something {0} thick lies under the {target} corner.",
    targets=FOOT_CORNERS,
    statics=False,
    instrument="cells",
)

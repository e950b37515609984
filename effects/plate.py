"""Effects on where a plate is recorded to be, and on where on it a load seems to be."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.lasting import Lasting
from tulip_testbed.effects.misreading import InstrumentFault, Misreading, added
from tulip_testbed.effects.targets import PLACEMENTS, PLATE_NAMES
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import TWIST
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.robot import Robot

HALF = 0.2  # m, half the side of a plate whose cells are not known, assumed
TURNS, EXACT = 60, 1e-15  # of the inverse of a map, at most; of the largest moment, below which none moves
POSES = "plate_poses"


def _misplaced(fault: InstrumentFault, axes: slice) -> np.ndarray:
    """Return recorded minus true poses, (2, 3) [m, m, rad], by the fault's values along some axes."""
    error = np.zeros((2, 3))
    error[PLATES.index(fault.target), axes] = fault.values
    return -error


def _moved_once(fault: InstrumentFault) -> np.ndarray:
    """Return recorded minus true poses, (m, 2, 3) [m, m, rad]."""
    placement = fault.measurements.placement
    error = np.zeros((len(placement), 2, 3))
    error[placement == int(fault.target), PLATES.index("left"), :2] = fault.values
    return -error


def _shown(load: np.ndarray, moment: np.ndarray, half: np.ndarray, values: Values) -> np.ndarray:
    """Return the moment that a plate shows of a load at a place, (m, 2) [Nm].

    Args:
        load: vertical force, (m,) [N]. moment: force times place, (m, 2) [Nm]. half: of the plate, (2,) [m].
    """
    down = np.where(load > 0, load, np.inf)
    u, v = np.clip(moment / (down[:, None] * half), -1.0, 1.0).T
    return moment + load[:, None] * (np.stack([u * u, u * v, v * v], axis=1) @ np.reshape(values, (2, 3)).T)


def _true(load: np.ndarray, shown: np.ndarray, half: np.ndarray, values: Values) -> np.ndarray:
    moment, most = shown, EXACT * np.abs(shown).max(initial=0.0)
    for _ in range(TURNS):
        step = _shown(load, moment, half, values) - shown
        moment = moment - step
        if np.abs(step).max(initial=0.0) <= most:
            break
    return moment


def _with_map(
    m: Measurements, readings: np.ndarray, target: str, values: Values, change: Callable[..., np.ndarray]
) -> np.ndarray:
    """Return readings of cells or channels, (m, 2, k), with the moments on a plate changed."""
    side, out = PLATES.index(target), readings.copy()
    if m.contacts is None:
        half = np.abs(m.cells[side]).max(axis=0)
        parts = np.vstack([np.ones(4), m.cells[side].T, TWIST])
    else:
        half, parts = np.full(2, HALF), np.zeros((3, len(m.contacts.channels)))
        for row, (channel, sign) in enumerate((("fz", 1), ("my", -1), ("mx", 1))):
            parts[row, m.contacts.channels.index(channel)] = sign
    load, *moment = parts[:3] @ out[:, side].T
    moment = np.stack(moment, axis=1)
    out[:, side] += (change(load, moment, half, values) - moment) @ np.linalg.pinv(parts).T[1:3]
    return out


def _bend(m: Measurements, robot: Robot, target: str, values: Values) -> Measurements:
    if m.contacts is None:
        bent = _with_map(m, m.cell_forces.reshape(-1, 2, 4), target, values, _shown)
        return replace(m, cell_forces=bent.reshape(-1, 8))
    assert m.wrenches is not None
    return replace(m, wrenches=_with_map(m, m.wrenches, target, values, _shown))


def _straighten(observed: Observation, target: str, values: Values) -> Observation:
    forces, scale = observed.cell_forces, observed.contacts.by_channel
    scale = np.eye(4) if scale is None else scale
    readings = forces.reshape(len(forces), 2, -1) @ np.linalg.inv(scale).T
    true = _with_map(observed.measurements, readings, target, values, _true) @ scale.T
    return observed.changed(cell_forces=true.reshape(forces.shape))


EFFECTS = (
    Effect(
        name="plate-translation",
        sentence="A plate is displaced from its recorded position, equally in every placement (base frame).",
        parameters=(Parameter("x", "m", prior=0.005), Parameter("y", "m", prior=0.005)),
        mechanism=added(POSES, partial(_misplaced, axes=slice(0, 2))),
        words="The {target} plate lies {0} further forward and {1} further left than recorded.",
        targets=PLATE_NAMES,
        instrument="plates",
        lasting=Lasting(until="survey"),
        explanation="""A plate is displaced from its recorded position, by the same vector in all placements.

        A wrong mark or origin does this. The centre of pressure shifts by the displacement times the plate's
        share of the load. For the right plate this is nearly constant, so the torso's parameters absorb it;
        for the left plate too, apart from the variation of its share.
        """,
    ),
    Effect(
        name="plate-yaw",
        sentence="A plate is rotated from its recorded pose, equally in every placement.",
        parameters=(Parameter("yaw", "rad", prior=np.radians(1.0)),),
        mechanism=added(POSES, partial(_misplaced, axes=slice(2, 3))),
        words="The {target} plate is rotated by {0} (to the left) from its recorded pose.",
        targets=PLATE_NAMES,
        instrument="plates",
        lasting=Lasting(until="survey"),
        explanation="A plate is rotated about its centre from its recorded pose, by the same angle in all "
        "placements.",
    ),
    Effect(
        name="placement-blunder",
        sentence="The left plate's position is recorded wrong in one placement (base frame).",
        parameters=(Parameter("x", "m", prior=0.01), Parameter("y", "m", prior=0.01)),
        mechanism=added(POSES, _moved_once),
        words="In placement {target} the left plate lies {0} further forward and {1} further left than "
        "recorded.",
        targets=PLACEMENTS,
        instrument="plates",
        explanation="The position of the left plate is recorded wrong in one placement: a misread tape or a "
        "slip of "
        "the pen.",
    ),
    Effect(
        name="plate-map",
        sentence="A plate shows the centre of pressure displaced by a quadratic function of its place.",
        parameters=tuple(
            Parameter(axis + term, "m", prior=0.003) for axis in "xy" for term in ("xx", "xy", "yy")
        ),
        mechanism=Misreading(_bend, _straighten),
        words="The {target} plate shows the centre of pressure further forward by {0} times xx, {1} times xy "
        "and {2} times yy, and further left by {3}, {4} and {5} times these (x, y: place over half of the "
        "plate).",
        targets=PLATE_NAMES,
        instrument="plates",
        lasting=Lasting(moves="plate", on_axes=True),
        searched=False,
        explanation="""A plate displaces the centre of pressure by a smooth function of the place: it bends,
        and its cells or channels are calibrated at few points.

        The displacement along x is xxx x x + xxy x y + xyy y y, and that along y likewise, in the plate's
        axes. x and y are the place over half of the plate: over the distance of its cells from the centre, or
        over 200 mm where these are not known. Beyond the edge it is as at the edge. The load and the twist of
        the board stay. Linear terms are those of `plate-translation`, `plate-yaw` and the gains.

        Six numbers per plate can imitate nearly anything that depends on where the robot stands, so a search
        does not try them. They are a family of ordinary imperfections with good plates (0.3 mm, assumed).
        Over the plate, a map of independent coefficients leaves 0.54 of their s.d. after an affine fit.
        """,
    ),
)

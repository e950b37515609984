"""Effects on where a plate is recorded to be."""

from __future__ import annotations

from functools import partial

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter
from tulip_testbed.effects.lasting import Lasting
from tulip_testbed.effects.misreading import InstrumentFault, added
from tulip_testbed.effects.targets import PLACEMENTS, PLATE_NAMES
from tulip_testbed.measurements.cells import PLATES

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


EFFECTS = (
    Effect(
        name="plate-translation",
        sentence="A plate is displaced from its recorded position, equally in every placement (base frame).",
        parameters=(Parameter("x", "m", prior=0.005), Parameter("y", "m", prior=0.005)),
        mechanism=added(POSES, partial(_misplaced, axes=slice(0, 2))),
        words="The {target} plate lies {0} further forward and {1} further left than recorded.",
        targets=PLATE_NAMES,
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
)

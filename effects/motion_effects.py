"""Effects that only a robot that moves shows: inertial parameters, and clocks that differ."""

from typing import NoReturn

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.effect import Effect, Parameter, Physics
from tulip_testbed.effects.foot import leaned, rocked
from tulip_testbed.effects.lasting import Values
from tulip_testbed.effects.targets import FEET, WHOLE, Targets
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.rig import Rig


def directions(observed: Observation) -> tuple[str, ...]:
    """Number the directions of inertial parameters that this motion shows, from 1."""
    return tuple(str(1 + k) for k in range(observed.motion.unknown.shape[2]))


def _without_inertia(observed: Observation, target: str, values: Values) -> Observation:
    return observed.accelerated(values[0] * observed.motion.unknown[..., int(target) - 1])


def _without_lag(observed: Observation, target: str, values: Values) -> Observation:
    """Return the observation of contacts that are read late, by the change of what they would read in time.

    By the model, since the rates of noisy cells are noise. The legs are closed at any time.
    """
    return observed.accelerated(-values[0] * observed.motion.rate)


def _without_damping(observed: Observation, target: str, values: Values) -> Observation:
    late = np.zeros_like(observed.motion.load_rates)
    side = PLATES.index(target)
    # Load to the front turns about +y, load to the left about -x; it turns by so much less as it grows.
    late[:, :, side] = np.array(values) * [1.0, -1.0] * observed.motion.load_rates[:, :, side, ::-1]
    return rocked(leaned(observed, late[:, 0]), late[:, 1:])


def _injected(rig: Rig, target: str, values: Values) -> NoReturn:
    raise InputError(
        "effects: found 'inertia', 'contact-lag' or 'foot-damping', expected a random robot or a preset with "
        "a lag"
    )


# Independent directions in the space of all links' inertial parameters, those first that change the contact
# forces of this motion most.
INERTIA = Effect(
    "inertia",
    "inertial parameters differ from CAD where the base parameters leave them open",
    (Parameter("deviation", "", prior=1.0),),
    Physics(_injected, _without_inertia),
    "direction {target} of the inertial parameters lies {0} of CAD's uncertainty off",
    Targets("DIRECTION", lambda robot, placements: ()),
    statics=False,
    searched=False,
)
LAG = Effect(
    "contact-lag",
    "the contact sensors are read later than the encoders",
    (Parameter("lag", "s", prior=0.01),),
    Physics(_injected, _without_lag),
    "the contact sensors lag {0} behind the encoders",
    WHOLE,
    statics=False,
    searched=False,
)
# A foot on a sole of compliance k and time constant t yields by k (M - t dM/dt).
DAMPING = Effect(
    "foot-damping",
    "A foot that rocks on its sole follows its load late.",
    tuple(Parameter(f"about {axis}", "rad s/Nm", prior=np.radians(0.05) * 0.03) for axis in "xy"),
    Physics(_injected, _without_damping),
    "The {target} foot follows its load late: it yields by {0} in roll and {1} in pitch less as that grows.",
    FEET,
    statics=False,
    searched=False,
)
MOTION_EFFECTS = (INERTIA, LAG, DAMPING)

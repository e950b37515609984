"""Effects that only a robot that moves shows: inertial parameters, and clocks that differ."""

from typing import NoReturn

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.effect import Effect, Parameter, Physics
from tulip_testbed.effects.foot import leaned, rocked
from tulip_testbed.effects.lasting import Values
from tulip_testbed.effects.targets import FEET, WHOLE, Targets
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import center
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.rig import Rig


def directions(observed: Observation) -> tuple[str, ...]:
    """Number the directions of inertial parameters that this motion shows, from 1."""
    return tuple(str(1 + k) for k in range(observed.motion.unknown.shape[2]))


def _without_inertia(observed: Observation, target: str, values: Values) -> Observation:
    return observed.accelerated(values[0] * observed.motion.unknown[..., int(target) - 1])


def _without_lag(observed: Observation, target: str, values: Values) -> Observation:
    """Return the cells' readings of the time of the angles, or the centre of mass of the readings' time.

    The latter leaves the change of inertial forces out, and the rates of noisy cells are noise: the larger of
    both is avoided. Of other sensors the rates are unknown. The legs are closed at any time: of angles that
    were moved themselves their closure would show the rates' noise alone, as evidence for no lag.
    """
    m = observed.measurements
    if m.cell_rates is not None and m.contacts is None:
        # Of an axis, by the stated places: a choice that moved with the estimate would not come to rest.
        noise = observed.cell_sd * np.linalg.norm(m.cells) / 2**0.5 / observed.weight
        if np.sqrt((observed.motion.by_cad[:, :2] ** 2).mean()) > noise:
            return observed.changed(cell_forces=observed.cell_forces + values[0] * m.cell_rates)
    assert m.joint_rates is not None
    earlier = observed.changed(joint_angles=observed.joint_angles - values[0] * m.joint_rates)
    before, now = (center(one) - one.geometry.regressor @ one.nominal.value for one in (earlier, observed))
    return observed.changed(shift=observed.shift + now - before)


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

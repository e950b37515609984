"""What base parameters leave open of a moving robot's inertial parameters, as a family of imperfections.

Its members are independent directions in the space of all links' inertial parameters, those first that change
the contact forces of this motion most, in s.d. of what CAD leaves uncertain.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NoReturn

from tulip_testbed.effects.effect import Effect, Parameter, Physics
from tulip_testbed.effects.lasting import Values
from tulip_testbed.effects.targets import Targets
from tulip_testbed.identification.observation import Observation
from tulip_testbed.sim.rig import Rig


def directions(observed: Observation) -> tuple[str, ...]:
    """Number the directions from 1."""
    return tuple(str(1 + k) for k in range(observed.motion.unknown.shape[2]))


def _removed(observed: Observation, target: str, values: Values) -> Observation:
    added = values[0] * observed.motion.unknown[..., int(target) - 1]
    return replace(
        observed,
        shift=observed.shift + added[:, :2],
        lift=observed.lift + added[:, 2],
        push=observed.push + added[:, 3:],
    )


def _injected(rig: Rig, target: str, values: Values) -> NoReturn:
    raise NotImplementedError("a random robot has other inertias")


INERTIA = Effect(
    "inertia",
    "inertial parameters differ from CAD where the base parameters leave them open",
    (Parameter("deviation", "", prior=1.0),),
    Physics(_injected, _removed),
    "direction {target} of the inertial parameters lies {0} of CAD's uncertainty off",
    Targets("DIRECTION", lambda robot, placements: ()),
    statics=False,
    searched=False,
)

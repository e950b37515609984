"""The grammar of laws: what errs, as a function of what, in which shape, and which sentences make sense.

Written `WHAT/OF/SHAPE`, for instance `encoder:right_knee/own-angle/sine`. A shape on cells may end in
`-gain`: the error is then in proportion to the cell's own load. In names, `/` is written `%2F` and `%` `%25`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple
from urllib.parse import unquote

from tulip_testbed.base.errors import InputError, listed, look_up, shortened
from tulip_testbed.effects.targets import leg_joints, links, plate_of
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.measurements.contacts import Contacts
from tulip_testbed.sim.robot import Robot, joint_names

LAW = "law"
ENCODER, ENCODERS, CELL, CELLS_OF, PLATE, FORCE = "encoder", "encoders", "cell", "cells", "plate", "force"
NOTHING, OWN_ANGLE, ANGLE, OWN_TORQUE, TORQUE = "nothing", "own-angle", "angle", "own-torque", "torque"
LEG_LOAD, PLATE_LOAD, COP, TIME, LOADED = "leg-load", "plate-load", "cop", "time", "time-since-loading"
BEFORE, DIRECTION = "posture-before", "direction"
CONSTANT, LINEAR, QUADRATIC, SINE, STEP = "constant", "linear", "quadratic", "sine", "step"
DEAD_BAND, SATURATING, RELAXATION, CURVE = "dead-band", "saturating", "relaxation", "curve"
FINE_CURVE = "fine-curve"
GAIN = "-gain"


class WhatErrs(NamedTuple):
    """Reading that errs.

    Attributes:
        field: of the measurements; "" for a force.
        instrument: as of `Effect`.
        words: how a sentence about it begins.
    """

    field: str
    instrument: str
    words: str


class Dependence(NamedTuple):
    """Quantity of which an error is a function.

    Attributes:
        unit: SI unit; a time is a fraction of the experiment's.
        words: how a sentence says it.
        ranged: whether a law has a range of it in which it was learned.
    """

    unit: str
    words: str
    ranged: bool = True


KINDS = {
    ENCODER: WhatErrs("joint_angles", "", "The {}'s encoder errs"),
    ENCODERS: WhatErrs("joint_angles", "", "The encoders of the {} leg err"),
    CELL: WhatErrs("cell_forces", "cells", "The {} cell errs"),
    CELLS_OF: WhatErrs("cell_forces", "cells", "The cells of the {} plate err"),
    PLATE: WhatErrs("plate_poses", "plates", "The {} plate's recorded pose errs"),
    FORCE: WhatErrs("", "", "A force acts on the {}"),
}
QUANTITIES = {
    NOTHING: Dependence("", "at all times", ranged=False),
    OWN_ANGLE: Dependence("rad", "with {own} own angle"),
    ANGLE: Dependence("rad", "with the {joint}'s angle"),
    OWN_TORQUE: Dependence("Nm", "with {own} own torque"),
    TORQUE: Dependence("Nm", "with the {joint}'s torque"),
    LEG_LOAD: Dependence("N", "with the load of {own} leg"),
    PLATE_LOAD: Dependence("N", "with the load of {own} plate"),
    COP: Dependence("m", "with the place of the load on the plate"),
    TIME: Dependence("of the time", "with time", ranged=False),
    LOADED: Dependence("s", "with the time since the set-up began"),
    BEFORE: Dependence("", "with the posture before", ranged=False),
    DIRECTION: Dependence("", "with the direction of approach", ranged=False),
}
_TIMES: dict[str, tuple[str, ...]] = {
    TIME: (LINEAR, QUADRATIC, SINE, STEP, SATURATING, CURVE, FINE_CURVE),
    LOADED: (LINEAR, SATURATING, CURVE),
    BEFORE: (RELAXATION,),
    DIRECTION: (STEP,),
}
_OF_ENCODERS: dict[str, tuple[str, ...]] = {
    NOTHING: (CONSTANT,),
    OWN_ANGLE: (LINEAR, QUADRATIC, SINE, STEP, DEAD_BAND, CURVE),
    ANGLE: (LINEAR, QUADRATIC, SINE, STEP, CURVE),
    OWN_TORQUE: (LINEAR, QUADRATIC, STEP, DEAD_BAND, SATURATING, CURVE),
    TORQUE: (LINEAR, QUADRATIC, STEP, CURVE),
    LEG_LOAD: (LINEAR, QUADRATIC, STEP, DEAD_BAND, SATURATING, CURVE),
    **_TIMES,
}
_OF_CELLS: dict[str, tuple[str, ...]] = {
    NOTHING: (CONSTANT,),
    PLATE_LOAD: (LINEAR, QUADRATIC, STEP, DEAD_BAND, SATURATING, CURVE),
    COP: (LINEAR, QUADRATIC),
    **_TIMES,
}
# Which shapes make sense, by what errs and as a function of what.
VALID: dict[str, dict[str, tuple[str, ...]]] = {
    ENCODER: _OF_ENCODERS,
    ENCODERS: _OF_ENCODERS,
    CELL: _OF_CELLS,
    CELLS_OF: _OF_CELLS,
    PLATE: {
        NOTHING: (CONSTANT,),
        TIME: (LINEAR, QUADRATIC, STEP),
        LOADED: (LINEAR, SATURATING),
        PLATE_LOAD: (LINEAR, QUADRATIC),
        COP: (LINEAR, QUADRATIC),
    },
    FORCE: {NOTHING: (CONSTANT,), TIME: (STEP, LINEAR)},
}
WITH_JOINT = (ANGLE, TORQUE)
# Sentences that say what an effect of the catalogue says: a search leaves them to the catalogue.
CATALOGUED = {
    (ENCODER, NOTHING, CONSTANT): "encoder-offset",
    (ENCODER, OWN_ANGLE, LINEAR): "encoder-gain",
    (ENCODER, OWN_TORQUE, LINEAR): "joint-compliance",
    (ENCODER, LEG_LOAD, LINEAR): "encoder-load",
    (ENCODER, TIME, STEP): "encoder-slip",
    (ENCODER, BEFORE, RELAXATION): "lag",
    (CELL, NOTHING, CONSTANT): "cell-tare",
    (CELL, NOTHING, CONSTANT + GAIN): "cell-gain",
    (CELL, TIME, LINEAR): "cell-drift",
    (CELLS_OF, TIME, LINEAR): "plate-drift",
    (PLATE, NOTHING, CONSTANT): "plate-translation",
}


@dataclass(frozen=True)
class Sentence:
    """A law: the reading that errs, the quantity it depends on, and the shape.

    Attributes:
        what: such as `encoder:right_knee`. of: such as `own-angle` or `angle:left_knee`.
        shape: such as `sine`; on cells also `sine-gain`.
    """

    what: str
    of: str
    shape: str

    def __str__(self) -> str:
        return f"{self.what}/{self.of}/{self.shape}"

    @cached_property
    def kind(self) -> str:
        """Return what errs without which one, such as `encoder`."""
        return self.what.partition(":")[0]

    @cached_property
    def place(self) -> str:
        """Return which one errs, such as `right_knee`."""
        return unquote(self.what.partition(":")[2])

    @cached_property
    def field(self) -> str:
        """Return the field of the measurements that errs, "" for a force."""
        return KINDS[self.kind].field

    @cached_property
    def quantity(self) -> str:
        """Return as a function of what, without which joint's."""
        return self.of.partition(":")[0]

    @cached_property
    def joint(self) -> str:
        """Return the joint of the quantity, "" if it has none."""
        return unquote(self.of.partition(":")[2])

    @cached_property
    def form(self) -> str:
        return self.shape.removesuffix(GAIN)

    @cached_property
    def scales(self) -> bool:
        """Return whether the error is in proportion to the cell's load."""
        return self.shape.endswith(GAIN)

    @property
    def catalogued(self) -> str:
        """Return the name of the effect in the catalogue that says the same, "" if there is none."""
        return CATALOGUED.get((self.kind, self.quantity, self.shape), "")


def shapes_of(kind: str, quantity: str) -> tuple[str, ...]:
    """List the shapes that make sense for something that errs with a quantity."""
    plain = VALID[kind].get(quantity, ())
    gains = kind in (CELL, CELLS_OF) and quantity not in (BEFORE, DIRECTION)
    return plain + tuple(f"{shape}{GAIN}" for shape in plain if gains)


@cache
def sentence_of(text: str, where: str = "law") -> Sentence:
    """Read `WHAT/OF/SHAPE`, without checking names against a robot; refuse what makes no sense."""
    parts = text.split("/")
    if len(parts) != 3:
        raise InputError(
            f"{where}: found '{shortened(text)}', expected WHAT/OF/SHAPE, such as "
            "encoder:right_knee/own-angle/sine (a / in a name is written %2F)"
        )
    found = Sentence(*parts)
    look_up("kind of what errs", found.kind, VALID, where)
    if not found.place:
        raise InputError(f"{where}: found '{shortened(found.what)}', expected {found.kind}:NAME")
    allowed = VALID[found.kind]
    if found.quantity not in allowed:
        raise InputError(
            f"{where}: found {found.kind} as a function of '{shortened(found.of)}', expected one of "
            f"{listed(_with_joint(one) for one in allowed)}"
        )
    if (found.quantity in WITH_JOINT) != bool(found.joint):
        raise InputError(f"{where}: found '{shortened(found.of)}', expected {_with_joint(found.quantity)}")
    shapes = shapes_of(found.kind, found.quantity)
    if found.shape not in shapes:
        raise InputError(
            f"{where}: found shape '{shortened(found.shape)}' of {found.of}, expected one of {listed(shapes)}"
        )
    return found


def _written(name: str) -> str:
    return name.replace("%", "%25").replace("/", "%2F")


def _with_joint(quantity: str) -> str:
    return f"{quantity}:JOINT" if quantity in WITH_JOINT else quantity


@cache
def whats(robot: Robot) -> tuple[str, ...]:
    """List everything of a robot and its plates that can err."""
    return (
        *(f"{ENCODER}:{_written(name)}" for name in joint_names(robot.model)),
        *(f"{ENCODERS}:{leg}" for leg in PLATES if joints_of_leg(robot, leg)),
        *(f"{CELL}:{name}" for name in CELLS),
        *(f"{CELLS_OF}:{name}" for name in PLATES),
        *(f"{PLATE}:{name}" for name in PLATES),
        *(f"{FORCE}:{_written(name)}" for name in links(robot)),
    )


@cache
def joints_of_leg(robot: Robot, leg: str) -> tuple[str, ...]:
    """List the joints between the torso and a foot, of which the plate's name is the leg's."""
    return tuple(name for name in leg_joints(robot) if plate_of(robot, name) == leg)


def joints_that_err(robot: Robot, what: str) -> tuple[str, ...]:
    """List the joints whose encoders err, () if none do."""
    kind, _, place = what.partition(":")
    if kind == ENCODER:
        return (unquote(place),)
    return joints_of_leg(robot, place) if kind == ENCODERS else ()


def quantities(robot: Robot, what: str) -> Iterator[str]:
    """Yield everything of which an error can be a function."""
    own = joints_that_err(robot, what)
    for quantity in VALID[what.partition(":")[0]]:
        if quantity in WITH_JOINT:
            yield from (
                f"{quantity}:{_written(name)}" for name in joint_names(robot.model) if name not in own
            )
        elif quantity != LEG_LOAD or all(plate_of(robot, name) for name in own):
            yield quantity


@cache
def sentences(robot: Robot) -> tuple[Sentence, ...]:
    return tuple(
        Sentence(what, of, shape)
        for what in whats(robot)
        for of in quantities(robot, what)
        for shape in shapes_of(what.partition(":")[0], of.partition(":")[0])
    )


def sentences_in(robot: Robot, contacts: Contacts | None) -> tuple[Sentence, ...]:
    """List the sentences about a robot on such contact sensors; None: plates on four cells each."""
    return tuple(one for one in sentences(robot) if contacts is None or not KINDS[one.kind].instrument)


def says(robot: Robot, found: Sentence) -> bool:
    """Return whether the robot has everything that a sentence speaks of."""
    return found.what in whats(robot) and found.of in quantities(robot, found.what)

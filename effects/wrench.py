"""Effects on force-torque sensors."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.lasting import Lasting
from tulip_testbed.effects.misreading import Misreading
from tulip_testbed.effects.targets import FEET, PLATE_NAMES, WRENCH_CHANNELS, WRENCH_PAIRS
from tulip_testbed.identification.contact_readings import LEVER
from tulip_testbed.identification.kinematics import turned_about
from tulip_testbed.identification.observation import Observation, fraction_of_time
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.measurements.contacts import WRENCH, Contacts
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.wrench_sensors import in_frame


def _unit(target: str) -> str:
    """Return the unit of the channel after the foot's name."""
    return "Nm" if target.partition(".")[2].startswith("m") else "N"


def _linear(matrix: Callable[[str, Values], np.ndarray]) -> Misreading:
    """Make a misreading of one foot's sensor of its reading per wrench, (6, 6), or the part that it has."""

    def of_foot(contacts: Contacts | None, target: str, values: Values) -> tuple[int, np.ndarray]:
        assert contacts is not None
        read = [WRENCH.index(channel) for channel in contacts.channels]
        return PLATES.index(target.partition(".")[0]), matrix(target, values)[read][:, read]

    def apply(m: Measurements, robot: Robot, target: str, values: Values) -> Measurements:
        assert m.wrenches is not None
        foot, by = of_foot(m.contacts, target, values)
        wrenches = m.wrenches.copy()
        wrenches[:, foot] = wrenches[:, foot] @ by.T
        return replace(m, wrenches=wrenches)

    def remove(observed: Observation, target: str, values: Values) -> Observation:
        scale, below = observed.contacts.by_channel, observed.contacts.below
        assert scale is not None
        assert below is not None
        foot, by = of_foot(observed.measurements.contacts, target, values)
        at = slice(foot * len(by), (foot + 1) * len(by))
        forces, added = observed.cell_forces.copy(), below[:, at]  # not read
        back = scale @ np.linalg.inv(by) @ observed.contacts.by_reading
        forces[:, at] = (forces[:, at] - added) @ back.T + added
        return observed.changed(cell_forces=forces)

    return Misreading(apply, remove)


def _crosstalk(target: str, values: Values) -> np.ndarray:
    _, channel, load = target.split(".")
    out = np.eye(6)
    out[WRENCH.index(channel), WRENCH.index(load)] += values[0]
    return out


def _crosstalk_unit(target: str) -> tuple[str, float]:
    channel, load = (name[0] for name in target.split(".")[1:])
    if channel == load:
        return "", 1.0
    return ("m", LEVER) if channel == "m" else ("1/m", 1 / LEVER)


def _rotation(target: str, values: Values) -> np.ndarray:
    return in_frame(turned_about(np.array(values)), np.zeros(3), np.eye(6)).T


def _origin(target: str, values: Values) -> np.ndarray:
    return in_frame(np.eye(3), np.array(values), np.eye(6)).T


def _zero(channels: tuple[str, ...], target: str, values: Values) -> np.ndarray:
    """Return reading minus wrench, (2, c) [N, Nm]."""
    foot, _, channel = target.partition(".")
    error = np.zeros((2, len(channels)))
    error[PLATES.index(foot), channels.index(channel)] = values[0]
    return error


def _offset(m: Measurements, robot: Robot, target: str, values: Values) -> Measurements:
    assert m.contacts is not None
    return replace(m, wrenches=m.wrenches + _zero(m.contacts.channels, target, values))


def _without_zero(observed: Observation, target: str, values: Values) -> Observation:
    return _less(observed, target, values, np.ones(len(observed)))


def _less(observed: Observation, target: str, values: Values, part: np.ndarray) -> Observation:
    """Return the observation with a part of a zero in each posture, (m,), subtracted."""
    contacts, scale = observed.measurements.contacts, observed.contacts.by_channel
    assert contacts is not None
    assert scale is not None
    error = (_zero(contacts.channels, target, values) @ scale.T).ravel()
    return observed.changed(cell_forces=observed.cell_forces - part[:, None] * error)


def _drift(m: Measurements, robot: Robot, target: str, values: Values) -> Measurements:
    assert m.contacts is not None
    error = _zero(m.contacts.channels, target, values)
    return replace(m, wrenches=m.wrenches + fraction_of_time(m.time)[:, None, None] * error)


def _without_drift(observed: Observation, target: str, values: Values) -> Observation:
    time, m = observed.time_fraction, observed.measurements
    foot, _, channel = target.partition(".")
    side = PLATES.index(foot)
    assert m.contacts is not None
    assert m.wrenches is not None
    # The zero was taken from the foot in the air, with the drift that it had there.
    air = ~feet_in_contact(m.support)[:, side] & np.isfinite(m.wrenches[:, side]).all(axis=1)
    unknown = m.contacts.zero_sd[side, m.contacts.channels.index(channel)] > 0
    return _less(observed, target, values, time - (time[air].mean() if unknown and air.any() else 0.0))


_on_sensor = partial(Effect, instrument="wrenches")
_in_foot = partial(Effect, instrument="feet")


EFFECTS = (
    _on_sensor(
        name="wrench-gain",
        sentence="A force-torque sensor reads all forces and moments in proportion too large.",
        parameters=(Parameter("gain error", "", prior=0.01),),
        mechanism=_linear(lambda target, values: (1 + values[0]) * np.eye(6)),
        words="The {target} force-torque sensor reads {0} too much of any load.",
        targets=PLATE_NAMES,
        explanation="""A force-torque sensor reads all forces and moments in proportion too large.

        Both sensors alike show in the sum of the forces against the weighed mass. One alone moves the centre
        of pressure towards its foot, as much as the load between the feet changes.
        """,
    ),
    _on_sensor(
        name="wrench-zero",
        sentence="A channel of a force-torque sensor reads a constant too much.",
        parameters=(Parameter("zero", "N or Nm", prior=1.0),),
        mechanism=Misreading(_offset, _without_zero),
        words="The {target} channel of the force-torque sensors reads {0} too much at any load.",
        targets=WRENCH_CHANNELS,
        lasting=Lasting(until="session"),
        unit_on=lambda target: (_unit(target), 1.0),
        explanation="""A channel of a force-torque sensor reads a constant too much: its zero is wrong.

        A foot in the air shows the zeros of its sensor. While both feet stand, the zeros of the moments pass
        for the centre of mass of the feet, and that of a vertical force for masses along the leg.
        """,
    ),
    _in_foot(
        name="wrench-crosstalk",
        sentence="A channel of a force-torque sensor also reads a part of another channel's load.",
        parameters=(Parameter("part", "1, m or 1/m", prior=0.05),),
        mechanism=_linear(_crosstalk),
        words="The {target} channels of the force-torque sensors: the first also reads {0} of the second.",
        targets=WRENCH_PAIRS,
        unit_on=_crosstalk_unit,
        explanation="""A channel of the force-torque sensor in a foot also reads a part of another channel's
        load: the matrix of its calibration is wrong in one entry. A part of a channel's own load is its gain.

        `left.my.fz=0.0003`: the left sensor's my reads 0.0003 Nm too much for every newton of fz. The part of
        a force in a force, or of a moment in a moment, is a ratio; that of a force in a moment is in m, that
        of a moment in a force in 1/m. Data sheets state it in ranges: a load over its range makes another
        channel read this part of its own. Plausible parts therefore are those of a ratio times 0.03 m, or
        over 0.03 m, the ratio of the ranges of moments and forces (60 Nm and 2000 N).

        Nothing is computed from mz, so cross-talk into that channel is left out.
        """,
    ),
    _in_foot(
        name="wrench-rotation",
        sentence="The force-torque sensor in a foot is rotated from its stated pose about its origin.",
        parameters=tuple(Parameter(axis, "rad", prior=np.radians(2.0)) for axis in "xyz"),
        mechanism=_linear(_rotation),
        words="The {target} foot's force-torque sensor is rotated by {0}, {1} and {2} about its x, y and z.",
        targets=FEET,
        explanation="""The force-torque sensor in a foot is rotated from its stated pose about its origin: by
        roll, pitch and yaw about the axes of the stated frame, in this order.

        It reads the same force and moment along other axes. Of a sensor that reads fz, mx and my alone, only
        the rotation about z is simulated.
        """,
    ),
    _in_foot(
        name="wrench-origin",
        sentence="The moments of the force-torque sensor in a foot are about a displaced origin.",
        parameters=tuple(Parameter(axis, "m", prior=0.005) for axis in "xyz"),
        mechanism=_linear(_origin),
        words="The moments of the {target} foot's force-torque sensor are about a point displaced by {0}, "
        "{1} and {2} along its x, y and z.",
        targets=FEET,
        explanation="""The moments of the force-torque sensor in a foot are about a point that is displaced
        from the stated origin, along the sensor's axes: it sits elsewhere, or its calibration has another
        origin.

        A displacement r changes the moment by - r x f. Of a sensor that reads fz, mx and my alone, only x
        and y are simulated. For a foot that bears the whole weight the change is constant, so the base
        parameters absorb it.
        """,
    ),
    _in_foot(
        name="wrench-drift",
        sentence="The zero of a force-torque sensor's channel drifts steadily, from 0 at the first posture "
        "to this at the last.",
        parameters=(Parameter("drift", "N or Nm", prior=5.0),),
        mechanism=Misreading(_drift, _without_drift),
        words="The zero of the {target} channel of the force-torque sensors drifts by {0} over the "
        "experiment.",
        targets=WRENCH_CHANNELS,
        unit_on=lambda target: (_unit(target), LEVER if _unit(target) == "Nm" else 1.0),
        explanation="""The zero of a channel of the force-torque sensor in a foot drifts steadily, as its
        strain gauges warm up.

        Where the zero is taken from the foot in the air, the mean drift there goes with it. Plausible drifts
        of a moment are 0.03 m times those of a force, the ratio of the ranges.
        """,
    ),
)

"""Effects on force-torque sensors."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.lasting import Lasting
from tulip_testbed.effects.misreading import Misreading
from tulip_testbed.effects.targets import PLATE_NAMES, WRENCH_CHANNELS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.robot import Robot


def _gain(target: str, values: Values) -> np.ndarray:
    """Return reading over wrench of both sensors, (2,)."""
    gain = np.ones(2)
    gain[PLATES.index(target)] += values[0]
    return gain


def _scale(m: Measurements, robot: Robot, target: str, values: Values) -> Measurements:
    assert m.wrenches is not None
    return replace(m, wrenches=m.wrenches * _gain(target, values)[:, None])


def _without_gain(observed: Observation, target: str, values: Values) -> Observation:
    gain = np.repeat(_gain(target, values), observed.cell_forces.shape[1] // 2)
    below = observed.contacts.below  # it was added, not read
    assert below is not None
    return observed.changed(cell_forces=(observed.cell_forces - below) / gain + below)


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
    contacts, scale = observed.measurements.contacts, observed.contacts.by_channel
    assert contacts is not None
    assert scale is not None
    error = _zero(contacts.channels, target, values) @ scale.T
    return observed.changed(cell_forces=observed.cell_forces - error.ravel())


_on_sensor = partial(Effect, instrument="wrenches")


EFFECTS = (
    _on_sensor(
        name="wrench-gain",
        sentence="A force-torque sensor reads all forces and moments in proportion too large.",
        parameters=(Parameter("gain error", "", prior=0.01),),
        mechanism=Misreading(_scale, _without_gain),
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
        unit_on=lambda target: "Nm" if target.partition(".")[2].startswith("m") else "N",
        explanation="""A channel of a force-torque sensor reads a constant too much: its zero is wrong.

        A foot in the air shows the zeros of its sensor. While both feet stand, the zeros of the moments pass
        for the centre of mass of the feet, and that of a vertical force for masses along the leg.
        """,
    ),
)

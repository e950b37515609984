"""A channel of a force-torque sensor reads a constant too much: its zero is wrong.

A foot in the air shows the zeros of its sensor. While both feet stand, the zeros of the moments pass for the
centre of mass of the feet, and that of a vertical force for masses along the leg.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.effects.effect import Effect, Misreading, Parameter, Values
from tulip_testbed.effects.targets import WRENCH_CHANNELS
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES


def _apply(m: Measurements, target: str, values: Values) -> Measurements:
    assert m.contacts is not None
    return replace(m, wrenches=m.wrenches + _error(m.contacts.channels, target, values))


def _undo(observed: Observation, target: str, values: Values) -> Observation:
    contacts, scale = observed.measurements.contacts, observed.contacts.by_channel
    assert contacts is not None
    assert scale is not None
    error = _error(contacts.channels, target, values) @ scale.T
    return observed.changed(cell_forces=observed.cell_forces - error.ravel())


def _error(channels: tuple[str, ...], target: str, values: Values) -> np.ndarray:
    """Return reading minus wrench, (2, c) [N, Nm]."""
    foot, _, channel = target.partition(".")
    error = np.zeros((2, len(channels)))
    error[PLATES.index(foot), channels.index(channel)] = values[0]
    return error


EFFECT = Effect(
    name="wrench-zero",
    sentence="A channel of a force-torque sensor reads a constant too much.",
    parameters=(Parameter("zero", "N or Nm", prior=1.0),),
    mechanism=Misreading(_apply, _undo),
    words="The {target} channel of the force-torque sensors reads {0} too much at any load.",
    targets=WRENCH_CHANNELS,
    instrument="wrenches",
    unit_on=lambda target: "Nm" if target.partition(".")[2].startswith("m") else "N",
)

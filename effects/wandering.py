"""Zeros of instruments that wander slowly, as a random walk does."""

import numpy as np

from tulip_testbed.effects.effect import Parameter
from tulip_testbed.effects.misreading import InstrumentFault

WAVES = 4
WANDERING = """The zero of an instrument wanders slowly: it follows the temperature of the room, of the motors
or of the amplifier.

error = sum over k of a_k sqrt(2) cos(k pi t) / k, with t the time as a fraction of the experiment's. These
are the first terms of a random walk less its mean (Karhunen and Loeve), whose coefficients a_k are
independent and equally large.
"""


def waves(unit: str, prior: float) -> tuple[Parameter, ...]:
    """Return the coefficients of a wandering zero."""
    return tuple(Parameter(f"a{k}", unit, prior=prior) for k in range(1, WAVES + 1))


def wandering(fault: InstrumentFault) -> np.ndarray:
    """Return the error over the experiment, (m,)."""
    k = np.arange(1, WAVES + 1)
    return np.cos(np.pi * k * fault.time[:, None]) @ (np.sqrt(2) * np.array(fault.values) / k)

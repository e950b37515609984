"""An ordinary laboratory: a little wrong in every way that the self-calibrating estimator knows of."""

from collections.abc import Sequence

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.calibration.families import Family, families_of, tolerances_of
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import Rig

SPREADS = (0.1, 1.0)  # tolerances


def check_scale(scale: float) -> None:
    """Refuse a scale by which no laboratory can be drawn.

    Raises:
        InputError: it is negative or not finite.
    """
    if not 0 <= scale < np.inf:
        raise InputError(
            f"imperfections: found {scale}, expected 0 (an exact laboratory) or a finite number above (1: "
            f"spreads of {SPREADS[0]:g} to {SPREADS[1]:g} tolerance)"
        )


def ordinary_members(rig: Rig, rng: np.random.Generator, scale: float = 1.0) -> tuple[EffectInstance, ...]:
    """Draw members of all families, with the tolerances of the sensors' data sheet.

    Args:
        rig: the laboratory. scale: of all members.
    """
    header = header_of(rig)
    families = families_of(rig.robot, tolerances_of(header.sensors), contacts=header.contacts)
    values, _ = draw_members(families, rng, scale)
    return tuple(i for family, v in zip(families, values, strict=True) for i in family.instances(v))


def draw_members(
    families: Sequence[Family], rng: np.random.Generator, scale: float = 1.0
) -> tuple[list[np.ndarray], np.ndarray]:
    """Draw a spread and then the members of every family: values by family, and spreads, (f,).

    A spread is uniform in `SPREADS` times `scale`; members are normal, or the absolute values of normal
    deviates where they cannot be negative.
    """
    spreads = scale * rng.uniform(*SPREADS, len(families))
    values = [s * f.sizes * rng.standard_normal(len(f)) for s, f in zip(spreads, families, strict=True)]
    return [np.abs(v) if f.positive else v for v, f in zip(values, families, strict=True)], spreads

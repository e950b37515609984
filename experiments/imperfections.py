"""Repeat an experiment in ordinary laboratories, each a little wrong in its own way."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.numbers import number
from tulip_testbed.calibration.families import Family, families_of, tolerances_of
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import Rig

SPREADS = (0.1, 1.0)  # tolerances
STREAM = 2**32 - 1  # spawn key of the members of a single experiment: no placement has this number
EXACT = (
    "Exact laboratory: the default estimator allows for imperfections that are not there, so its standard "
    "errors are too large."
)
NO_NOISE = ("ideal",)  # sensors that have neither noise nor tolerances


def check_imperfections(laboratory: Laboratory, scale: float) -> None:
    """Refuse a scale of imperfections that cannot be drawn; 0: the laboratory is exact."""
    if not 0 <= scale < np.inf:
        raise InputError(
            f"imperfections: found {scale}, expected 0 (an exact laboratory) or a finite number above (1: "
            f"spreads of {SPREADS[0]:g} to {SPREADS[1]:g} tolerance)"
        )
    if scale and laboratory.sensors in NO_NOISE:
        raise InputError(
            f"imperfections: found {scale:g} with sensors {laboratory.sensors}, whose data sheet leads to no "
            "tolerances; expected 0 (an exact laboratory) or other sensors"
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


def drawn(laboratory: Laboratory, scale: float, stream: np.random.SeedSequence) -> Laboratory:
    """Hide ordinary imperfections of a scale in a laboratory, drawn from their own stream; 0: none."""
    if not scale:
        return laboratory
    members = ordinary_members(laboratory.rig, np.random.default_rng(stream), scale)
    return replace(laboratory, hidden=laboratory.hidden + members)


def single_stream(seed: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed, spawn_key=(STREAM,))


def imperfections_line(scale: float, several: bool = False) -> str:
    """Describe the imperfections that were drawn, once or in every one of several runs."""
    if not scale:
        return EXACT
    low, high = (number(scale * spread, "g") for spread in SPREADS)
    whose = "laboratories, drawn again in every run" if several else "laboratory"
    return f"Ordinary {whose}: imperfections of all families, with spreads of {low} to {high} tolerances."

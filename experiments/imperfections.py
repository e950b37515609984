"""Repeat an experiment in ordinary laboratories, each a little wrong in its own way."""

from dataclasses import replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.numbers import number
from tulip_testbed.calibration.ordinary_laboratory import SPREADS, check_scale, ordinary_members
from tulip_testbed.experiments.laboratory import Laboratory

STREAM = 2**32 - 1  # spawn key of the members of a single experiment: no placement has this number
EXACT = (
    "Exact laboratory: the default estimator allows for imperfections that are not there, so its standard "
    "errors are too large."
)
NO_NOISE = ("ideal",)  # sensors that have neither noise nor tolerances


def check_imperfections(laboratory: Laboratory, scale: float) -> None:
    """Refuse a scale of imperfections that cannot be drawn; 0: the laboratory is exact."""
    check_scale(scale)
    if scale and laboratory.sensors in NO_NOISE:
        raise InputError(
            f"imperfections: found {scale:g} with sensors {laboratory.sensors}, whose data sheet leads to no "
            "tolerances; expected 0 (an exact laboratory) or other sensors"
        )


def drawn(laboratory: Laboratory, scale: float, stream: np.random.SeedSequence) -> Laboratory:
    """Hide ordinary imperfections of a scale in a laboratory, drawn from their own stream; 0: none."""
    if not scale:
        return laboratory
    members = ordinary_members(laboratory.rig, np.random.default_rng(stream), scale)
    return replace(laboratory, hidden=laboratory.hidden + members)


def single_stream(seed: int) -> np.random.SeedSequence:
    """Return the stream of the imperfections of a single experiment."""
    return np.random.SeedSequence(seed, spawn_key=(STREAM,))


def imperfections_line(scale: float, several: bool = False) -> str:
    """Describe the imperfections that were drawn, once or in every one of several runs."""
    if not scale:
        return EXACT
    low, high = (number(scale * spread, "g") for spread in SPREADS)
    whose = "laboratories, drawn again in every run" if several else "laboratory"
    return f"Ordinary {whose}: imperfections of all families, with spreads of {low} to {high} tolerances."

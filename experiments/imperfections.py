"""Repeat an experiment in ordinary laboratories, each a little wrong in its own way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.calibration.calibrated_estimate import SELF_CALIBRATING
from tulip_testbed.calibration.ordinary_laboratory import check_scale, ordinary_members
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.estimators import DEFAULT

STREAM = 2**32 - 1  # spawn key of the members of a single experiment: no placement has this number


def default_estimator(estimator: str | None, ordinary: float | None, laboratory: Laboratory) -> str:
    """Return the estimator that was asked for, or the one that fits the laboratory.

    Zeros of wrench sensors and ordinary imperfections are estimated by the self-calibrating one alone.

    Args:
        ordinary: scale of the imperfections; None: the laboratory has none.
    """
    exact = ordinary is None and laboratory.rig.sensors.wrench is None
    if estimator is not None:
        return estimator
    return DEFAULT if exact else SELF_CALIBRATING


def check_ordinary(laboratory: Laboratory, ordinary: float | None) -> None:
    """Refuse imperfections that cannot be drawn.

    Args:
        ordinary: scale of the imperfections; None: there are none to draw.

    Raises:
        InputError: an impossible scale, or sensors whose data sheet leads to no tolerances.
    """
    if ordinary is None:
        return
    check_scale(ordinary)
    if laboratory.sensors == "ideal":
        raise InputError(
            "ordinary: found sensors ideal, whose data sheet leads to no tolerances; valid: wii, force-plate"
        )


def drawn(laboratory: Laboratory, ordinary: float | None, stream: np.random.SeedSequence) -> Laboratory:
    """Hide ordinary imperfections in a laboratory.

    Args:
        ordinary: their scale; None: there are none.
        stream: of their draw alone.
    """
    if ordinary is None:
        return laboratory
    members = ordinary_members(laboratory.rig, np.random.default_rng(stream), ordinary)
    return replace(laboratory, hidden=laboratory.hidden + members)


def single_stream(seed: int) -> np.random.SeedSequence:
    """Return the stream of the imperfections of a single experiment."""
    return np.random.SeedSequence(seed, spawn_key=(STREAM,))

"""Compliance of MuJoCo's soft constraints at rest (its documentation, "Solver parameters").

A constraint of depth x and impedance d bears K d^2 x / ((1 - d) mobility) with K = 1 / (dmax timeconst
dampratio)^2. It is a spring; its mobility is the inverse inertia that the solver assumes.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

MOST_IMPEDANCE = 0.9999  # MuJoCo's upper bound
LEAST_WIDTH = 1e-15  # rad or m


@dataclass(frozen=True)
class Stops:
    """Soft limits of the coordinates in MuJoCo's parameters, each (n,).

    Attributes:
        low, high: limits, infinite where there are none [rad].
        rate: reference acceleration over depth, 1 / (dmax timeconst dampratio)^2 [1/s2].
        least, most, width: impedance at the limit, and at a depth of `width` [rad] or more.
        middle, power: where in `width` the impedance turns, and how steeply.
        mobility: inverse of the inertia that the solver assumes, `dof_invweight0`.
    """

    low: np.ndarray
    high: np.ndarray
    rate: np.ndarray
    least: np.ndarray
    most: np.ndarray
    width: np.ndarray
    middle: np.ndarray
    power: np.ndarray
    mobility: np.ndarray


def stops_of(model: mujoco.MjModel, joints: list[int], dofs: np.ndarray) -> Stops:
    """Read the limits of some joints, whose degrees of freedom are `dofs`."""
    limited = model.jnt_limited[joints].astype(bool)
    reference, impedance = model.jnt_solref[joints], model.jnt_solimp[joints]
    least, most, middle = (np.clip(impedance[:, k], 1e-4, MOST_IMPEDANCE) for k in (0, 1, 3))
    margin = model.jnt_margin[joints]  # a limit acts from this distance on
    return Stops(
        low=np.where(limited, model.jnt_range[joints, 0] + margin, -np.inf),
        high=np.where(limited, model.jnt_range[joints, 1] - margin, np.inf),
        rate=_rate(model, reference, most),
        least=least,
        most=most,
        width=np.maximum(impedance[:, 2], LEAST_WIDTH),
        middle=middle,
        power=np.maximum(impedance[:, 4], 1.0),
        mobility=model.dof_invweight0[dofs],
    )


def stop_torques(stops: Stops, angles: np.ndarray) -> np.ndarray:
    """Return the torques of the limits' soft constraints at rest, K x d^2 / ((1 - d) mobility), (..., n)."""
    over = np.maximum(stops.low - angles, 0.0) - np.maximum(angles - stops.high, 0.0)
    if not over.any():
        return over
    part = np.minimum(np.abs(over) / stops.width, 1.0)
    middle, power = stops.middle, stops.power
    ramp = np.where(
        part < middle,
        part**power / middle ** (power - 1),
        1 - (1 - part) ** power / (1 - middle) ** (power - 1),
    )
    d = stops.least + ramp * (stops.most - stops.least)
    return stops.rate * d**2 / ((1 - d) * stops.mobility) * over


def board_compliance(points: np.ndarray, compliance: float) -> np.ndarray:
    """Return height, roll and pitch compliance of a board on equal springs at points (4, 2), (3, 3)."""
    levers = np.column_stack([np.ones(len(points)), points[:, 1], -points[:, 0]])
    return compliance * np.linalg.inv(levers.T @ levers)


def contact_compliance(model: mujoco.MjModel, geom: str, other: str | None) -> float:
    """Return (1 - d) mobility / (K d^2) [m/N], as in `Stops`, of a contact at rest; None: with the floor."""
    this = model.geom(geom)
    mobility = model.body_invweight0[this.bodyid[0], 0]
    reference, impedance = this.solref, this.solimp
    if other is not None:
        that = model.geom(other)
        mobility = mobility + model.body_invweight0[that.bodyid[0], 0]
        geoms = {int(this.id), int(that.id)}
        pair = next(
            k for k in range(model.npair) if {int(model.pair_geom1[k]), int(model.pair_geom2[k])} == geoms
        )
        reference, impedance = model.pair_solref[pair], model.pair_solimp[pair]
    d = min(float(impedance[0]), MOST_IMPEDANCE)
    rate = _rate(model, reference[None], min(float(impedance[1]), MOST_IMPEDANCE))[0]
    return float((1 - d) * mobility / (rate * d**2))


def _rate(model: mujoco.MjModel, reference: np.ndarray, most: np.ndarray | float) -> np.ndarray:
    """Return K of `solref` (k, 2): time constant and damping ratio, or negative stiffness and damping.

    MuJoCo keeps the time constant at two steps or more.
    """
    standard = reference[:, 0] > 0
    constant = np.maximum(reference[:, 0], 2 * model.opt.timestep)
    time = np.where(standard, constant * reference[:, 1], 1.0)
    return np.where(standard, 1 / (most * time) ** 2, -reference[:, 0] / most**2)

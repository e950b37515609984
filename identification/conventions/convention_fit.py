"""The likelihood of measured wrenches under a convention, with what else may be wrong fitted.

The nominal robot needs a wrench; the measured one differs by unknowns that enter linearly, each with a normal
prior, and by a residual of unknown covariance that lasts. They are fitted under every convention alike, so
that a robot 10 % off, a foot that rocks, or a sensor with cross-talk does not decide for a wrong one.
"""

from dataclasses import dataclass

import numpy as np

from tulip_testbed.identification.inertial_wrench import link_wrenches
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.measurements import Measurements

# Prior s.d. of the unknowns.
MASS = 0.1  # of each link, relative
ROCKING, ROCKED_BY = np.radians(1.0), 0.06  # tilt of the foot under the weight at that distance, rad and m
CROSS_TALK, ARM = 0.02, 0.03  # relative; m: range of moments over that of forces
TURN = np.radians(2.0)  # of the sensor
ORIGIN = 0.05  # m, of the point of the moments
ZERO_FORCE, ZERO_MOMENT = 0.05, 0.02  # constant part, of the weight and weight times metre
FLOOR_FORCE, FLOOR_MOMENT = 0.003, 0.001  # likewise: a residual below it is none
FEWEST = 3  # rows for a correlation
BELOW, BELOW_ARM = 0.02, 0.05  # of the weight, m: what hangs below a sensor in the air
ROUNDS = 5
MOST_LASTING = 0.9  # correlation of a row with the next: more is a wrong convention, not noise


@dataclass(frozen=True)
class NeededWrench:
    """The wrench that the nominal robot needs and what may change it, of m rows in the base frame.

    Attributes:
        wrench: (m, 6) [N, Nm]. weight: [N].
        common: of all conventions, (m, 6, c): changes by 1 s.d. of masses, cross-talk, zeros, rotation.
        rocking: of a foot that rocks about x and y: seen in the foot's axes, and in the world's,
            (2, m, 6, 2).
    """

    wrench: np.ndarray
    weight: float
    common: np.ndarray
    rocking: np.ndarray


@dataclass(frozen=True)
class ConventionFit:
    """How well a convention fits.

    Attributes:
        log_likelihood: of the rows that count, integrated over the unknowns [-].
        residual: unexplained part of the measured wrench, (m, 6) [N, Nm].
        origin: of the moments from the stated point, in the axes of the body that has it, and its s.d.,
            (2, 3) [m].
    """

    log_likelihood: float
    residual: np.ndarray
    origin: np.ndarray


def needed(nominal: Nominal, measurements: Measurements) -> NeededWrench:
    """Compute the needed wrench with its nuisances."""
    links, centers = link_wrenches(nominal, measurements)
    wrench, weight = links.sum(axis=1), nominal.mass * measurements.gravity
    units = np.repeat([1.0, ARM], 3)
    talk = CROSS_TALK * np.einsum("mk,ji->mijk", wrench / units, np.diag(units)).reshape(len(wrench), 6, 36)
    zeros = np.diag(np.repeat([ZERO_FORCE, ZERO_MOMENT], 3)) * weight
    common = [
        MASS * links.mT,
        talk,
        np.broadcast_to(zeros, (len(wrench), 6, 6)),
        *(TURN * _turned(wrench, axis)[..., None] for axis in np.eye(3)),
    ]
    seen, rocks = [], ROCKING / (ROCKED_BY * weight)
    for k in (0, 1):
        tilt = np.zeros((len(wrench), 3))
        tilt[:, k] = rocks * wrench[:, 3 + k]
        force = -np.cross(tilt[:, None], links[..., :3])
        in_foot = np.concatenate([force, np.cross(centers, force)], axis=2).sum(axis=1)
        seen.append([in_foot, in_foot + _turned(wrench, tilt)])
    return NeededWrench(wrench, weight, np.concatenate(common, axis=2), np.moveaxis(np.array(seen), 0, -1))


def _turned(wrench: np.ndarray, by: np.ndarray) -> np.ndarray:
    """Return the change of a wrench that is turned by a small rotation vector, (m, 6)."""
    return np.concatenate([np.cross(by, wrench[:, :3]), np.cross(by, wrench[:, 3:])], axis=1)


def fit_convention(
    measured: np.ndarray, need: NeededWrench, in_world: bool, body: np.ndarray | None, rows: float
) -> ConventionFit:
    """Fit the unknowns under a convention.

    Args:
        measured: total wrench in the base frame, (m, 6) [N, Nm].
        in_world: whether the wrench is in the world's axes.
        body: axes of the link that the point of the moments is fixed in, (m, 3, 3); None: the foot.
        rows: how many independent rows the m rows count for.
    """
    count, weight = len(measured), need.weight
    axes = np.broadcast_to(np.eye(3), (count, 3, 3)) if body is None else body
    lever = ORIGIN * np.cross([0.0, 0.0, weight], axes.mT).mT  # of the weight: the rest is mostly noise
    parts = [need.common, need.rocking[int(in_world)], np.concatenate([np.zeros_like(lever), lever], axis=1)]
    columns = np.concatenate(parts, axis=2)
    off = measured - need.wrench
    floor = np.diag(np.repeat([FLOOR_FORCE, FLOOR_MOMENT], 3) ** 2) * weight**2
    covariance = floor + np.diag((off**2).mean(axis=0))
    unit = np.eye(columns.shape[2])
    residual, found, information = off, np.zeros(len(unit)), unit
    for _ in range(ROUNDS):
        root = np.linalg.cholesky(np.linalg.inv(covariance)).T * np.sqrt(rows / count)
        matrix, output = (root @ columns).reshape(6 * count, -1), (off @ root.T).ravel()
        information = unit + matrix.T @ matrix
        found = np.linalg.solve(information, matrix.T @ output)
        residual = off - columns @ found
        covariance = floor + residual.T @ residual / count
    bits = rows * np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1] + found @ found
    where = slice(need.common.shape[2] + 2, need.common.shape[2] + 5)
    spread = np.sqrt(np.diag(np.linalg.inv(information))[where])
    return ConventionFit(
        log_likelihood=-0.5 * float(bits), residual=residual, origin=ORIGIN * np.array([found[where], spread])
    )


def reading_in_the_air(readings: np.ndarray, upright: np.ndarray, weight: float, rows: float) -> float:
    """Return the log-likelihood of what a foot in the air reads: in the sensor's axes its zero, a constant.

    In other axes the zero turns with the foot. The foot's own weight, with unknown centre, may hang below the
    sensor.

    Args:
        readings: (k, 6) [N, Nm]. upright: vertical direction in the sensor's axes, (k, 3).
        rows: how many independent rows they count for.
    """
    if not rows:
        return 0.0
    floor = np.repeat([FLOOR_FORCE, FLOOR_MOMENT], 3) * weight
    turned = upright - upright.mean(axis=0)
    hangs = np.zeros((len(turned), 6, 4))
    hangs[:, :3, 0] = BELOW * turned
    hangs[:, 3:, 1:] = BELOW * BELOW_ARM * np.cross(np.eye(3), turned[:, None]).mT
    matrix = (weight * hangs / floor[:, None]).reshape(-1, 4) * np.sqrt(rows / len(turned))
    output = ((readings - readings.mean(axis=0)) / floor).ravel() * np.sqrt(rows / len(turned))
    found = np.linalg.solve(np.eye(4) + matrix.T @ matrix, matrix.T @ output)
    residual = (output - matrix @ found).reshape(-1, 6)
    return -0.5 * rows * float(np.log1p((residual**2).sum(axis=0) / rows).sum())


def effective_rows(residual: np.ndarray) -> float:
    """Return how many independent rows m consecutive rows count for, by their correlation with the next."""
    if len(residual) < FEWEST:
        return float(len(residual))
    centred = residual - residual.mean(axis=0)
    scaled = centred / np.maximum(centred.std(axis=0), 1e-12)
    lasting = float(np.clip((scaled[1:] * scaled[:-1]).mean(), 0.0, MOST_LASTING))
    return len(residual) * (1 - lasting) / (1 + lasting)

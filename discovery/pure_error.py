"""Pure error: the noise that repeated postures show, regardless of the model."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tulip_testbed.identification.distributions import chi2_sf
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import CHANNELS, ROWS, residuals, residuals_in_use
from tulip_testbed.identification.residual_noise import Noise, cell_by_twist, encoder_by_closure, whitening

CONTRADICTED = 1e-3  # level below which repeats overrule a data sheet


@dataclass(frozen=True)
class PureError:
    """Differences between repeated readings, relative to the stated noise.

    Attributes:
        pairs: number of pairs of repeated readings within a stance.
        ratio: chi-square per degree of freedom by channel. p: probability of a larger one.
    """

    pairs: int
    ratio: dict[str, float]
    p: dict[str, float]


def pure_error(observed: Observation, theta: np.ndarray, noise: Noise) -> PureError:
    """Compare repeats within a stance, where errors that their postures share cancel.

    The commanded posture is the same but the held one differs, so residuals are compared, not readings.

    Args:
        theta: base parameters, (p,) [m].
    """
    alike: dict[tuple[int, int], list[int]] = {}
    for row, key in enumerate(zip(observed.measurements.posture, observed.stance, strict=True)):
        alike.setdefault(key, []).append(row)
    pairs = sorted(pair for rows in alike.values() for pair in combinations(rows, 2))
    if not pairs:
        return PureError(0, {}, {})
    residual, own = residuals(observed, theta), whitening(observed, theta, noise).own
    first, second = np.array(pairs).T
    ratio, p = {}, {}
    used = residuals_in_use(observed)
    for channel in CHANNELS:
        rows = ROWS[channel]
        apart = (residual[first] - residual[second])[:, rows]
        covariance = (own[first] + own[second])[:, rows, rows]
        use = used[first][:, rows].all(axis=1) & used[second][:, rows].all(axis=1)
        solved = np.linalg.solve(covariance[use], apart[use, :, None])[..., 0]
        size = float((apart[use] * solved).sum())
        dof = int(use.sum()) * (rows.stop - rows.start)
        if dof:
            ratio[channel], p[channel] = size / dof, float(chi2_sf(size, dof))
    return PureError(len(pairs), ratio, p)


def widened(observed: Observation, noise: Noise, repeats: PureError) -> Noise:
    """Return the stated noise, or a larger one where repeats contradict it: cells by F and T, encoders by C.

    Few repeats show that a data sheet is wrong, but not by how much. The noise of the cells then follows from
    the twist of the plates in all postures, that of the encoders from the closure of the legs.

    Args:
        observed: the experiment with the effects that were found removed.
    """
    cells = [repeats.ratio[c] for c in "FT" if repeats.p.get(c, 1.0) < CONTRADICTED]
    encoders = [repeats.ratio["C"]] if repeats.p.get("C", 1.0) < CONTRADICTED else []
    assumed = noise.assumed
    if cells:
        found = cell_by_twist(observed) or noise.cell * float(np.sqrt(max(cells)))
        noise = replace(noise, cell=max(noise.cell, found))
        assumed += ("cells (repeats scatter more than the data sheet says)",)
    if encoders:
        by_legs = encoder_by_closure(observed) or noise.encoder * float(np.sqrt(encoders[0]))
        noise = replace(noise, encoder=max(noise.encoder, by_legs))
        assumed += ("encoders (repeats scatter more than the data sheet says)",)
    return replace(noise, assumed=assumed) if cells or encoders else noise

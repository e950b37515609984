"""What repeated postures say of the noise, whatever the model: pure error."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from experiments.discovery.channels import CHANNELS, ROWS, residuals
from experiments.discovery.noise import Noise, whitening
from experiments.effects.seen import Seen

CONTRADICTED = 1e-3  # level at which repeats overrule a data sheet


@dataclass(frozen=True)
class PureError:
    """Differences between repeated readings, over what the stated noise makes of them.

    Attributes:
        pairs: of repeated readings within a stance.
        ratio: chi-square per degree of freedom by channel. p: probability of more.
    """

    pairs: int
    ratio: dict[str, float]
    p: dict[str, float]


def pure_error(seen: Seen, theta: np.ndarray, noise: Noise) -> PureError:
    """Compare repeats within a stance: what their postures share cancels.

    The commanded posture is the same, the held one differs: residuals are compared, not readings.

    Args:
        theta: base parameters, (p,) [m].
    """
    number, m = seen.measurements.posture, len(seen)
    pairs = [
        (i, j)
        for i in range(m)
        for j in range(i + 1, m)
        if number[i] == number[j] and seen.stance[i] == seen.stance[j]
    ]
    if not pairs:
        return PureError(0, {}, {})
    residual, own = residuals(seen, theta), whitening(seen, theta, noise).own
    first, second = np.array(pairs).T
    ratio, p = {}, {}
    for channel in CHANNELS:
        rows = ROWS[channel]
        apart = (residual[first] - residual[second])[:, rows]
        covariance = (own[first] + own[second])[:, rows, rows]
        keep = seen.on_four_cells[first].all(axis=1) & seen.on_four_cells[second].all(axis=1)
        use = keep if channel == "T" else np.ones(len(first), bool)
        solved = np.linalg.solve(covariance, apart[..., None])[..., 0]
        size = float((apart * solved)[use].sum())
        freedom = int(use.sum()) * (rows.stop - rows.start)
        if freedom:
            ratio[channel], p[channel] = size / freedom, float(chi2.sf(size, freedom))
    return PureError(len(pairs), ratio, p)


def widened(noise: Noise, repeats: PureError) -> Noise:
    """The stated noise, or more where repeats contradict it: cells by F and T, encoders by C."""
    cells = [repeats.ratio[c] for c in "FT" if repeats.p.get(c, 1.0) < CONTRADICTED]
    encoders = repeats.ratio["C"] if repeats.p.get("C", 1.0) < CONTRADICTED else 1.0
    if not cells and encoders == 1.0:
        return noise
    assumed = noise.assumed
    if cells:
        assumed += ("cells (repeats scatter more than the data sheet says)",)
    if encoders > 1:
        assumed += ("encoders (repeats scatter more than the data sheet says)",)
    return replace(
        noise,
        cell=noise.cell * float(np.sqrt(max(cells, default=1.0))),
        encoder=noise.encoder * float(np.sqrt(encoders)),
        assumed=assumed,
    )

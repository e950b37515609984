"""Cross-validation over placements: do the effects predict placements that took no part in the fit?"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.calibration.families import EXACT
from tulip_testbed.calibration.prediction import predicted
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.discovery.candidate_search import CandidateSearch, part_of
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.selection import calibrated_with_best
from tulip_testbed.effects.instance import removed
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.identification.distributions import chi2_isf
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import CHANNELS, packed
from tulip_testbed.measurements import Measurements

FOLDS = 4
LEAST_PLACEMENTS = 4
SAME = 1e-9  # difference of readings that rounding makes [SI]
# Of a held-out value by chance: 0.1 % a channel. Folds share their estimates, so it is a little more.
CHANCE = 1e-3


@dataclass(frozen=True)
class HeldOut:
    """Residuals of placements that took no part in the fit.

    Attributes:
        before, after: root mean squares of the whitened residuals of the nominal model and with everything
            that was found, by channel and of all channels ("AFTC"); 1 is the noise, the same for both, as it
            was estimated with everything that was found.
        floor: largest value of `after` that chance explains, by channel.
        millimetres: root mean square of the centre of pressure's residuals before, after, and by the noise
            alone, (3,) [mm]. newtons: the same of the sum of the vertical forces [N].
    """

    before: dict[str, float]
    after: dict[str, float]
    floor: dict[str, float]
    millimetres: tuple[float, float, float]
    newtons: tuple[float, float, float]

    @property
    def holds(self) -> bool:
        """Whether no channel is predicted worse than chance allows."""
        return all(self.after[key] <= self.floor[key] for key in self.after)


def check_placements(measurements: Measurements) -> None:
    """Refuse measurements with too few placements for cross-validation.

    Raises:
        InputError: with the number that was found and the number that is needed.
    """
    count = len(np.unique(measurements.placement))
    if count < LEAST_PLACEMENTS:
        raise InputError(
            f"measurements: found {count} placements, expected at least {LEAST_PLACEMENTS}: "
            "whether a finding holds is shown on placements that took no part in it"
        )


def of_one_placement(observed: Observation, term: Fitted) -> bool:
    """Return whether an effect acts on a single placement, which alone may show it."""
    if (timed := term.candidate.time_parameter) is None:
        return term.candidate.effect.targets is PLACEMENTS
    began = observed.time_fraction >= term.values[timed]
    return len(np.unique(observed.measurements.placement[began])) == 1


def lasts_beyond_placements(observed: Observation, term: Fitted, rows: np.ndarray) -> bool:
    """Return whether what an effect does in some placements depends on the others, as the creep of a cell."""
    part = packed(term.removed(observed))[rows] - packed(term.removed(observed.take(rows)))
    return bool(np.abs(part).max() > SAME)


def held_out(search: CandidateSearch, found: SelfCalibration, terms: Sequence[Fitted]) -> HeldOut:
    """Cross-validate over placements: everything is estimated from the other placements alone.

    Families, noise, base parameters and sizes are estimated in every fold, and every effect is chosen again:
    the best candidate in addition to the other effects takes its place.

    Args:
        found: the calibration of all placements, with the effects.

    Raises:
        InputError: fewer placements than cross-validation needs.
    """
    observed = search.observed
    check_placements(observed.measurements)
    placements = np.unique(observed.measurements.placement)
    fold = np.searchsorted(placements, observed.measurements.placement) % FOLDS
    # Such an effect cannot be learnt from the other placements. It is removed as fitted to all.
    single = [
        term.label
        for term in terms
        if of_one_placement(observed, term) or lasts_beyond_placements(observed, term, fold > 0)
    ]
    corrected = removed(observed, [one for one in found.effects if one.label in single])
    general = tuple(term for term in terms if term.label not in single)
    sums = {key: np.zeros(3) for key in (*CHANNELS, "AFTC")}
    squares = {"A": np.zeros(3), "F": np.zeros(3)}
    for k in range(FOLDS):
        inside, outside = np.flatnonzero(fold == k), np.flatnonzero(fold != k)
        exact = self_calibrate(observed.take(outside), EXACT, rounds=1)
        mine = search.of_part(corrected, outside)
        calibration = calibrated_with_best(mine, general, part_of(found, outside))
        fitted = predicted(calibration, corrected.take(inside))
        # Both in units of one noise: by a larger one alone "after" would look better than "before".
        plain = predicted(replace(exact, noise=calibration.noise), observed.take(inside))
        for key in sums:
            before, after = plain.of(key), fitted.of(key)
            dof = len(after.residual)
            if dof:
                sums[key] += before.chi_square, after.chi_square, dof
        for key, sizes in squares.items():
            first, last = plain.of(key), fitted.of(key)
            sizes += (first.residual**2).sum(), (last.residual**2).sum(), last.variance.sum()
        del exact, mine, calibration, fitted, plain  # large: one fold at a time
    sums = {key: total for key, total in sums.items() if total[2] > 0}
    millimetres = 1e3 * np.sqrt(squares["A"] / (2 * len(observed)))
    newtons = np.sqrt(squares["F"] / len(observed))
    return HeldOut(
        before={key: float(np.sqrt(t[0] / t[2])) for key, t in sums.items()},
        after={key: float(np.sqrt(t[1] / t[2])) for key, t in sums.items()},
        floor={key: float(np.sqrt(chi2_isf(CHANCE, t[2]) / t[2])) for key, t in sums.items()},
        millimetres=tuple(millimetres.tolist()),
        newtons=tuple(newtons.tolist()),
    )

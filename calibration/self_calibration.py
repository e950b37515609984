"""Self-calibration: base parameters and all ordinary imperfections in one estimate.

The residuals of all channels are linear about the current estimate,

    r = R(q) (theta - theta_0) + sum_f G_f (phi_f - phi_f0) + stances + weight + e,

with the members' columns at the readings without the members and without the noise as far as both are known.
`reml` estimates everything; then the members are removed at their estimate by the effects' own formulas and
the columns are computed again, until nothing moves (Gauss-Newton, damped where it goes back and forth).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from tulip_testbed.calibration.calibration_result import STEADY, SelfCalibration, result_of
from tulip_testbed.calibration.families import SOLE, Tolerances, families_in, tolerances_of
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.calibration.lasting_noise import likeliest_noise
from tulip_testbed.calibration.linear_model import first_parameters
from tulip_testbed.calibration.linear_problem import LinearProblem
from tulip_testbed.calibration.linearisation import (
    Families,
    LinearisationPoint,
    Linearised,
    ResidualCovariance,
    at_sizes,
    center_of,
    linearised,
    mixing_of,
    sources_of,
    split_members,
)
from tulip_testbed.calibration.member_removal import members_removed
from tulip_testbed.calibration.reml import LikelihoodFit, fit, given
from tulip_testbed.effects.instance import EffectInstance, removed
from tulip_testbed.identification.noise_in_time import Decorrelation, NoiseInTime, apart
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import (
    ROWS,
    has_direction,
    has_twist,
    moved_by,
    packed,
    residuals_in_use,
)
from tulip_testbed.identification.residual_noise import noise_of, with_cell_noise

ROUNDS = 16
BEYOND_DOUBT = 4.0  # s.e. by which a member is negative that cannot be
NEARLY_TIPPED = 0.8  # of the compliance with which a robot would tip over
WORSE = 10.0  # ln of the evidence, by which the last linearisation may lie below the best
LASTING, LASTING_ROUNDS = NoiseInTime(0.9, 4.0), 4
# Rounds of a moving record with spreads of one tolerance. Noise is removed from the columns by the scales
# found so far; wrong ones leave some of it, and thousands of rows make it evidence for a wide family.
SETTLING = 4
INDEPENDENT = 2.0  # times, that noise lasts, between rows whose noise counts as independent
# Share of the information that may be noise of the columns while something moves. A step with the rest of it
# alone is 1 / (1 - share) times too long where the columns hold no noise after all, as where a missing effect
# has widened its scale: from a half on it would lead further away each time.
STABLE_EXCESS = 0.5
STANDS = 0.25  # s.e. by which nothing moves any more: the next step would move it by about a fifth of that


def self_calibrate(
    observed: Observation,
    tolerances: Mapping[str, float] | None = None,
    effects: Sequence[EffectInstance] = (),
    start: SelfCalibration | None = None,
    residual_covariance: ResidualCovariance | None = None,
    rounds: int = ROUNDS,
    absent: tuple[str, ...] | None = None,
) -> SelfCalibration:
    """Estimate base parameters and members.

    Nothing yields against its load. Where a compliance of a robot at rest would be negative beyond doubt,
    something else is wrong, such as a play in a joint that bears no load, and the compliances are left out.

    Args:
        observed: the experiment.
        tolerances: of families, in place of those of the measurements and those that fit the sensors [SI];
            zero: exact.
        effects: that are no members of a family; their sizes are estimated, beginning where they are.
        start: an estimate of the same experiment from which this one begins.
        residual_covariance: that of another estimate, whose unseen wrench counts, so that the evidence of
            several estimates can be compared: it depends on how well the compliances are known. None: that of
            the members found.
        rounds: largest number of linearisations.
        absent: families that are left out; None: those of the start, or those that would be negative.

    Raises:
        InputError: an unknown family or an impossible tolerance.
        numpy.linalg.LinAlgError: readings that are not finite, or postures that do not suffice.
    """
    given = absent if start is None or absent is not None else start.absent
    left_out = given or ()
    found = _calibrated(observed, tolerances, effects, start, residual_covariance, rounds, left_out)
    while given is None and not observed.moves and found.steady and (wrong := _negative(found)):
        left_out = *left_out, *wrong
        try:
            found = _calibrated(observed, tolerances, effects, None, residual_covariance, rounds, left_out)
        except np.linalg.LinAlgError:
            break
    return found


@np.errstate(divide="ignore", invalid="ignore")  # a step may leave no load; then an error is raised
def _calibrated(
    observed: Observation,
    tolerances: Mapping[str, float] | None,
    effects: Sequence[EffectInstance],
    start: SelfCalibration | None,
    residual_covariance: ResidualCovariance | None,
    rounds: int,
    absent: tuple[str, ...],
) -> SelfCalibration:
    """Calibrate without some families, see `self_calibrate`."""
    observed = with_cell_noise(observed).weighing(0.0)
    if tolerances:  # what the result says of the mass counts them too
        stated = observed.measurements
        stated = replace(stated, tolerances={**stated.tolerances, **tolerances})
        observed = observed.changed(measurements=stated)
    used = usual_tolerances(observed, None)
    families: Families = (
        *(
            one.lying_about(observed.compliances)
            for one in families_in(observed, used, effects)
            if one.name not in absent
        ),
        *map(FreeEffect, effects),
    )
    noise = noise_of(observed)
    p = observed.geometry.regressor.shape[2]
    _, owner = mixing_of(families)
    scales, spreads = np.ones(len(sources_of(observed))), np.ones(len(owner))
    phi, variance = _first(families, start)
    if start is None:
        known = [one for family in families for one in family.instances(family.center) if family.center.any()]
        clean = removed(observed, [*effects, *known])  # members at zero change nothing
        smooth, nu = clean, np.append(first_parameters(clean), 0.0)
    else:
        nu, scales, spreads = start.nu, start.solved.scales, _spreads(families, start)
        if observed.cad is not None and start.observed.cad is not None:
            observed = observed.changed(cad=start.observed.cad)
        errors = packed(start.observed) - packed(start.linear.smooth)
        observed = observed.weighing(start.observed.heavier)
        clean = members_removed(observed, families, phi, nu[:p], start.covariance, errors)
        smooth = moved_by(clean, start.observed, start.linear.smooth)
        smooth = smooth.changed(tree=clean.tree, cells=clean.cells)
    latest: tuple[LinearProblem, Linearised] | None = None
    best: tuple[LinearisationPoint, Families, LikelihoodFit, Observation, float] | None = None
    before: tuple[np.ndarray, ...] | None = None
    center, settled = center_of(families), False
    along = np.linalg.pinv(mixing_of(families)[0]) @ (phi - center) * _lengths(families)
    for count in range(rounds):
        families = tuple(at_sizes(family, part) for family, part in split_members(families, phi))
        both, lengths = block_diag(np.eye(p + 1), mixing_of(families)[0]), _lengths(families)
        state = LinearisationPoint(clean, smooth, nu, along / lengths, variance, scales, residual_covariance)
        latest = None  # a linear model is large: one at a time
        problem, linear = latest = linearised(state, families, noise)
        noisy = count == 0 and start is None
        problem = problem if settled else replace(problem, most_excess=STABLE_EXCESS)
        # At first the columns hold the readings' noise: they could explain it with no noise at all.
        if count < SETTLING and start is None and clean.in_time is not None:
            problem = replace(problem, known=tuple(range(len(problem.sizes))))
        solved = given(problem, scales, spreads) if noisy else fit(problem, (scales, spreads))
        smooth = linear.smooth
        del problem, linear
        estimate, covariance = both @ solved.estimate, both @ solved.covariance @ both.T
        solved = replace(solved, log_evidence=solved.log_evidence - _of_weight(clean))
        if (cad := clean.cad) is not None:
            solved = replace(solved, log_evidence=solved.log_evidence + cad.log_density)
            scaled = cad if noisy else cad.rescaled(estimate[:p], solved.conditional[:p, :p])
            observed = observed.changed(cad=scaled)
            estimate[:p] += cad.center
        estimate[p + 1 :] += center
        step = (estimate - np.append(nu, phi)) / np.sqrt(np.diag(covariance))
        moved, errors = float(np.abs(step).max()), packed(clean) - packed(smooth)
        variance, scales, spreads = np.diag(covariance)[p + 1 :], solved.scales, solved.spreads
        nu, phi, along = estimate[: p + 1], estimate[p + 1 :], solved.estimate[p + 1 :] * lengths
        if not has_twist(observed):
            observed = observed.weighing(float(nu[p]))
        clean = members_removed(observed, families, phi, nu[:p], covariance[:p, :p], errors)
        if moved < STANDS:
            if settled or not solved.limited or residual_covariance is not None:
                break
            settled = True
        near = moved < STEADY, solved.log_evidence  # on the way to an estimate, evidence says little
        if not noisy and (best is None or near > (best[4] < STEADY, best[2].log_evidence)):
            # Without what they have computed, for the sake of memory.
            bare = replace(state, clean=replace(state.clean), smooth=replace(state.smooth))
            best = bare, families, solved, clean, moved
        reached = step, nu, phi, along
        share = _share_of_last(step, before[0]) if before is not None and count + 1 < rounds else 0.0
        if before is not None and share:
            nu, phi, along = (a + share * (b - a) for a, b in zip(reached[1:], before[1:], strict=True))
            clean = members_removed(observed, families, phi, nu[:p], covariance[:p, :p], errors)
        before = None if noisy else reached
    assert latest is not None
    # Where nothing came to rest, the steps may have led away, as they do with a large play. Where it did, an
    # earlier state has nothing to say: its noise was that of other compliances.
    rests = moved < STANDS or (best is not None and moved < STEADY <= best[4])
    if not rests and best is not None and solved.log_evidence < best[2].log_evidence - WORSE:
        state, families, solved, clean, moved = best
        latest = linearised(state, families, noise)
    if clean.cad is not None:
        clean = clean.changed(cad=state.clean.cad)  # with which the result was computed
    return result_of(clean, families, noise, *latest, solved, used.assumed, moved, absent)


def _negative(found: SelfCalibration) -> list[str]:
    """Name the families of which a member is negative beyond doubt and cannot be."""
    return [
        one.family.name
        for one in found.families
        if one.family.positive and (one.value + one.family.center < -BEYOND_DOUBT * one.standard_error).any()
    ]


def _of_weight(clean: Observation) -> float:
    """Return ln of the density of residuals over the estimated weight per that of the readings themselves.

    Over a larger weight all residuals are smaller, those of a wrong model too.
    """
    used = residuals_in_use(clean)
    count = used[:, ROWS["A"]].sum() + (used[:, ROWS["T"]].sum() if has_direction(clean) else 0)
    return float(count * np.log(clean.weight / (clean.weight - clean.heavier)))


def as_log_shows(
    observed: Observation, tolerances: Mapping[str, float] | None = None, rows: np.ndarray | None = None
) -> tuple[Observation, SelfCalibration | None]:
    """Return a moving record with what some of its rows show of inertial forces and of soft soles.

    Also return the calibration of those rows that says so; None: the record does not move. Of plates, which
    show all forces, it is shown how long their noise lasts.

    Contact sensors may not show the inertial forces: their signals are filtered, or a soft foot rocks in
    place of the body. Whichever has more evidence is taken; an estimate that does not come to rest has none
    if the other one does. Soles so soft that the robot would tip over are none: then nothing is to be learnt
    about them.

    Args:
        rows: those that may be looked at, (n,); None: all.
    """
    if not observed.moves:
        return observed, None
    if not observed.in_feet:
        return _with_lasting_noise(observed, tolerances, rows)
    for one in (observed, _on_hard_soles(observed)):
        both = (one, without_inertia(one))
        tried = [self_calibrate(o if rows is None else o.take(rows), tolerances) for o in both]
        best = max((0, 1), key=lambda k: (tried[k].steady, tried[k].solved.log_evidence))
        # An estimate that tips over seldom comes to rest.
        if not _tips_over(max(tried, key=lambda one: one.solved.log_evidence)):
            break
    return both[best], tried[best]


def _with_lasting_noise(
    observed: Observation, tolerances: Mapping[str, float] | None, rows: np.ndarray | None
) -> tuple[Observation, SelfCalibration | None]:
    """Find how long the noise lasts, beginning with noise that lasts: otherwise families would explain it.

    Where a gross fault lets no calibration converge, it stays as assumed, so that the fault can be searched.
    """
    some, lasting, found = observed if rows is None else observed.take(rows), LASTING, None
    far = set[NoiseInTime]()

    def decorrelated(one: NoiseInTime) -> Decorrelation:
        in_time = some.changed(noise_in_time=one).in_time
        assert in_time is not None
        return in_time

    for count in range(LASTING_ROUNDS):
        some = some.changed(noise_in_time=lasting)
        try:
            found = self_calibrate(some, tolerances, start=found)
        except np.linalg.LinAlgError:
            return observed.changed(noise_in_time=lasting), None
        start = lasting if count else None
        lasting = likeliest_noise(found.problem, found.solved, start, decorrelated, far)
        if lasting == some.noise_in_time:
            break
    return observed.changed(noise_in_time=some.noise_in_time), found


def with_independent_rows(observed: Observation) -> Observation:
    """Return those rows of a moving record between which its noise has changed, as if they were held."""
    lasting, m = observed.noise_in_time, observed.measurements
    assert lasting is not None
    rows = apart(m.time, observed.segment, INDEPENDENT * lasting.seconds if lasting.share else 0.0)
    return observed.take(rows).changed(noise_in_time=None)


def _tips_over(calibration: SelfCalibration) -> bool:
    """Whether a foot is so soft that hardly any height or weight more would tip the robot over."""
    observed = calibration.observed
    most = NEARLY_TIPPED / float((observed.height * observed.loaded_weight).max())
    return any((one.value > most).any() for one in calibration.families if one.family.name == SOLE)


def _on_hard_soles(observed: Observation) -> Observation:
    measured = observed.measurements
    return replace(observed, measurements=replace(measured, tolerances={**measured.tolerances, SOLE: 0.0}))


def without_inertia(observed: Observation) -> Observation:
    """Return a moving record as if its contact sensors did not show the inertial forces."""
    motion = observed.motion
    return observed.accelerated(-motion.by_cad).changed(
        motion=replace(
            motion,
            slope=0 * motion.slope,
            unknown=motion.unknown[..., :0],
            rocking=0 * motion.rocking,
            yielding=0 * motion.yielding,
            shown=False,
        ),
    )


def least_determined(observed: Observation, tolerances: Mapping[str, float] | None = None) -> list[str]:
    """Name the families, those first whose members the data determine least at spread 1.

    Args:
        observed, tolerances: see `self_calibrate`.
    """
    families = families_in(observed, usual_tolerances(observed, tolerances))
    mixing, _ = mixing_of(families)
    sizes = [sum(part.shape[1] for part in family.parts) for family in families]
    nu = np.append(first_parameters(observed), 0.0)
    left = np.ones(sum(sizes))  # variance of the deviates over that of their prior
    variance, scales = (mixing**2).sum(axis=1), np.ones(len(sources_of(observed)))
    try:
        state = LinearisationPoint(observed, observed, nu, 0 * left, variance, scales, None)
        problem, _ = linearised(state, families, noise_of(observed))
        left = np.diag(given(problem, scales, np.ones(len(problem.sizes))).conditional)[len(nu) :]
    except np.linalg.LinAlgError:
        pass  # then the order is the table's
    share = [part.mean() for part in np.split(left, np.cumsum(sizes)[:-1])]
    return [families[k].name for k in np.argsort(-np.array(share), kind="stable")]


def usual_tolerances(observed: Observation, given: Mapping[str, float] | None) -> Tolerances:
    measured = observed.measurements
    return tolerances_of(measured.sensors, {**measured.tolerances, **(given or {})})


def _estimated(start: SelfCalibration | None) -> dict[str, tuple[float, float]]:
    """Return value and s.e. of every member and size as estimated before, by label [SI]."""
    if start is None:
        return {}
    out = {}
    for calibrated in start.families:
        each = zip(calibrated.value.tolist(), calibrated.standard_error.tolist(), strict=True)
        out |= dict(zip(calibrated.family.labels, each, strict=True))
    for effect, error in zip(map(FreeEffect, start.effects), start.effect_errors, strict=True):
        out |= dict(zip(effect.labels, zip(effect.sizes.tolist(), error.tolist(), strict=True), strict=True))
    return out


def _first(families: Families, start: SelfCalibration | None) -> tuple[np.ndarray, np.ndarray]:
    """Return members and sizes with which to begin, (q,) [SI], and their variance, (q,).

    Members begin where they were estimated before, otherwise at zero; effects begin where they are.
    """
    known, sizes, variances = _estimated(start), [np.zeros(0)], [np.zeros(0)]
    for family in families:
        before = [known.get(label, (0.0, np.nan)) for label in family.labels]
        value, error = np.array(before).reshape(-1, 2).T
        prior = sum(((part**2).sum(axis=1) for part in family.parts), np.zeros(len(family)))
        sizes.append(family.sizes if isinstance(family, FreeEffect) else value + family.center)
        variances.append(np.where(np.isfinite(error), error**2, prior))
    return np.concatenate(sizes), np.concatenate(variances)


def _share_of_last(step: np.ndarray, last: np.ndarray) -> float:
    """Return the share of the last estimate in the next start, between 0 and a half (Anderson 1965).

    If the steps were linear, this mean of both estimates would move least. It damps steps that go back and
    forth about the solution, which remains the same; steps that shrink to less than half need no damping.
    More of the last one would hardly be a step.

    Args:
        step, last: what the latest two linearisations moved, (n,) [s.e.].
    """
    if step @ step < 0.25 * (last @ last):
        return 0.0
    change = step - last
    return float(np.clip(step @ change / max(change @ change, 1e-300), 0.0, 0.5))


def _lengths(families: Families) -> np.ndarray:
    """Return the lengths of the columns of `mixing_of`, (k,): those of effects change with their sizes."""
    return np.linalg.norm(mixing_of(families)[0], axis=0)


def _spreads(families: Families, start: SelfCalibration) -> np.ndarray:
    """Return the spread of every part of the families as estimated before, or 1, (f,)."""
    names = [family.name for family in start.all]
    _, owner = mixing_of(start.all)
    known = {names[j]: start.solved.spreads[owner == j] for j in set(owner.tolist())}
    out = []
    for family in families:
        size, before = len(family.parts), known.get(family.name, np.ones(0))
        free = isinstance(family, FreeEffect) or len(before) != size
        out += [1.0] * size if free else before.tolist()
    return np.array(out)

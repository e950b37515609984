"""Compare how identified and CAD masses predict the centre of pressure of postures that took no part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import lsq_linear, minimize

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.base.numbers import number
from tulip_testbed.base.progress import Advance, Progress, silent
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.calibration.prediction import center_errors
from tulip_testbed.calibration.self_calibration import as_log_shows, self_calibrate
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.posture_splits import Split, by_blocks, by_halves, clusters, stated
from tulip_testbed.identification.base_parameters import common_support, standard_parameters
from tulip_testbed.identification.cad_prior import CENTER_SD, MASS_SD, cad_prior
from tulip_testbed.identification.center_of_pressure import contact_pressure
from tulip_testbed.identification.distributions import t_ppf
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.regressor import check_robot, regression, with_cad_where_needed
from tulip_testbed.identification.residual_channels import ROWS, by_base_parameters
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.robot import Robot, load_spec
from tulip_testbed.sim.specs import compile_spec

CAD, CAD_WITH_OFFSET, CONSTANT = "CAD", "CAD with offset", "constant"
EXPORTED, IDENTIFIED, WITH_CORRECTIONS = "exported", "identified", "identified with corrections"
WORDS = {True: "yes", False: "no", None: "undecided"}
MODELS = (CAD, CAD_WITH_OFFSET, CONSTANT, IDENTIFIED, WITH_CORRECTIONS)
LEAST_BLOCKS = 3  # that an interval needs
RESAMPLES, SEED = 2000, 0
STARTS = (0.1, 1.0)  # of the prior's scale
HARMLESS = 1e-5  # m: residuals that leave nothing to beat
WIDE = 0.1  # m: what a zero of which nothing is known may move the centre of pressure by
SMALLEST = 1e-6  # m: changes and s.d. that count as none
PLAUSIBLE = 2.0  # s.d. of a zero
ROUNDING = 1e-14  # of the largest variance: noise that is smaller is none
WIDEST = 1.0  # of the prior's scale: beyond, masses would be absurd


@dataclass(frozen=True)
class Axes:
    """A value in x and one in y [mm]."""

    x: float
    y: float


@dataclass(frozen=True)
class Score:
    """How well a model predicts.

    Attributes:
        name: of the model. split: see `Split`.
        rms_mm: of the residuals [mm].
        low95, high95: their 95 % interval, by blocks [mm]; None: too few blocks.
        beats_cad, beats_cad_with_offset: whether the mean squared residual is less than that of this model;
            None: undecided.
    """

    name: str
    split: str
    rms_mm: Axes
    low95: Axes | None
    high95: Axes | None
    beats_cad: bool | None
    beats_cad_with_offset: bool | None


def _axes(values: np.ndarray) -> Axes:
    """Return lengths [m] in millimetres."""
    x, y = (round(1e3 * float(value), 4) for value in values)
    return Axes(x, y)


@dataclass(frozen=True, repr=False)
class Prediction(Result):
    """How well the models predict postures that took no part.

    Attributes:
        models: scores of every model and split.
        beats_cad: whether the identified masses beat CAD on the first split; None: undecided.
        beats_cad_with_offset: whether masses and corrections together beat CAD with an offset of the contact
            frame there; None: undecided or not possible.
        notes: what could not be done and why, and how the prior was weighed.
    """

    models: tuple[Score, ...]
    beats_cad: bool | None
    beats_cad_with_offset: bool | None
    notes: tuple[str, ...]

    @property
    def verdict(self) -> str:
        words = WORDS | {None: "undecided, these postures do not decide it"}
        return (
            f"Identified beats CAD: {words[self.beats_cad]}. Identified with corrections beats CAD with "
            f"offset: {words[self.beats_cad_with_offset]}."
        )

    def tables(self) -> list[Table | str]:
        rms = ((f"r.m.s. {axis} (95 %)", "mm", ".2f") for axis in "xy")
        heads = ("model", "postures left out by", *rms, "beats CAD", "beats CAD with offset")
        rows = []
        for score in self.models:
            ends = (score.rms_mm, score.low95, score.high95)
            cells = [tuple(np.nan if e is None else getattr(e, axis) for e in ends) for axis in "xy"]
            beats = "" if score.name == CAD else WORDS[score.beats_cad]
            offset = "" if score.name in (CAD, CAD_WITH_OFFSET) else WORDS[score.beats_cad_with_offset]
            rows.append([score.name, score.split, *cells, beats, offset])
        note = "Intervals: bootstrap over blocks; beats CAD: Student's t over the same blocks, 95 %."
        return [
            Table("Centre of pressure of postures that took no part", heads, rows, note),
            *self.notes,
            self.verdict,
        ]


def predict(
    measurements: Measurements,
    robot: Robot,
    train: Sequence[str] = (),
    test: Sequence[str] = (),
    source: str = "measurements",
    adopted: Sequence[EffectInstance] = (),
    exported: Path | None = None,
    progress: Progress = silent,
) -> Prediction:
    """Score models on postures that took no part in their training; see `tulip_testbed.predict`."""
    nominal = nominal_robot(robot, common_support(measurements.support))
    check_robot(nominal.parameters, measurements, robot, source)
    problem = PredictionProblem(measurements, nominal)
    change = None
    if exported is not None:  # how the masses of a model file change CAD's centre of mass, (m, 2) [m]
        cad, other = robot.model, compile_spec(load_spec(exported), str(exported))
        links, there = ([model.body(k).name for k in range(1, model.nbody)] for model in (cad, other))
        if there != links:
            raise InputError(f"{exported}: found the links {listed(there)}, expected {listed(links)}")
        values = [nominal.parameters.values(standard_parameters(model)) for model in (cad, other)]
        change = problem.matrix @ (values[1] - values[0])
    splits = [by_blocks(measurements), by_halves(measurements)]
    if train or test:
        splits = [stated(measurements, train, test)]
    scores, notes = list[Score](), list[str]()
    with progress("parts left out", sum(len(split.folds) for split in splits), 0) as advance:
        for split in splits:
            _score(problem, split, adopted, change, scores, notes, advance)
    first = {one.name: one for one in scores if one.split == splits[0].name}
    return Prediction(
        models=tuple(scores),
        beats_cad=first[IDENTIFIED].beats_cad,
        beats_cad_with_offset=(
            first[WITH_CORRECTIONS].beats_cad_with_offset if WITH_CORRECTIONS in first else None
        ),
        notes=tuple(dict.fromkeys(notes)),
    )


def cad_errors(problem: PredictionProblem, train: np.ndarray, offset: bool = False) -> np.ndarray:
    """Return CAD's residuals less what zeros explain of the training postures', (m, 2) [m].

    Zeros have their prior, next to the scatter that no zeros explain: what the training does not determine
    stays near zero. They stay within two s.d.: what only larger ones would explain is CAD's.

    Args:
        offset: whether a constant explains a part too, so that no zero has to make up for it.
    """
    count, free = problem.zeros.shape[2], 2 if offset else 0
    if not count + free:
        return problem.residual
    constant = np.broadcast_to(np.eye(2)[:, :free], (len(problem.residual), 2, free))
    every = np.concatenate([problem.zeros, constant], axis=2)
    target, columns = problem.residual[train].ravel(), _rows(every, train)
    left = target - columns @ np.linalg.lstsq(columns, target)[0]
    noise = max(float(np.sqrt((left**2).mean())), SMALLEST)
    whole = np.vstack([columns, noise * np.eye(count, count + free)])
    most = np.repeat([PLAUSIBLE, np.inf], [count, free])
    return problem.residual - every @ lsq_linear(whole, np.append(target, np.zeros(count)), (-most, most)).x


def _score(
    problem: PredictionProblem,
    split: Split,
    adopted: Sequence[EffectInstance],
    change: np.ndarray | None,
    scores: list[Score],
    notes: list[str],
    advance: Advance,
) -> None:
    m = problem.observed.measurements
    rows = np.concatenate([test for _, test in split.folds])
    models = (*MODELS, *([] if change is None else [EXPORTED]))
    found: dict[str, list[np.ndarray]] = {name: [] for name in models}
    scales, unsteady = [], 0
    for train, test in split.folds:
        if not len(train):
            raise InputError(f"{split.name}: found no posture to train with, expected two blocks or more")
        of_cad = cad_errors(problem, train)
        found[CAD].append(of_cad[test])
        found[CAD_WITH_OFFSET].append(cad_errors(problem, train, offset=True)[test])
        found[CONSTANT].append(problem.center[test] - problem.center[train].mean(axis=0))
        if change is not None:
            found[EXPORTED].append((of_cad - change)[test])
        residual, scale = _with_prior(problem, train, test)
        scales.append(scale)
        found[IDENTIFIED].append(residual)
        if WITH_CORRECTIONS in found:
            try:
                errors, steady = corrected_errors(problem, adopted, train, test)
                found[WITH_CORRECTIONS].append(errors)
                unsteady += not steady
            except (InputError, np.linalg.LinAlgError) as reason:
                notes.append(f"No model with corrections by {split.name}: {reason}.")
                found.pop(WITH_CORRECTIONS)
        advance(1)
    if problem.zeros.shape[2]:
        unknown = problem.observed.contacts.unknown
        free = unknown is not None and unknown.any()
        known, how = ("unknown", "freely") if free else ("known by their s.d. only", "within it")
        weight = "weighed mass" if m.weighed_mass else "nominal mass" if free else "measured forces"
        notes.append(
            f"The sensors' zeros are {known}: those of every model, CAD too, are fitted {how} in training, "
            f"and the weight is that of the {weight}."
        )
    if unsteady:
        notes.append(
            f"{WITH_CORRECTIONS} by {split.name}: in {unsteady} of {len(split.folds)} trainings the estimate "
            "did not come to rest; what it predicts there means nothing."
        )
    if scales:
        ends = dict.fromkeys(number(end, ".2f") for end in (min(scales), max(scales)))
        notes.append(
            f"Prior by {split.name}: s.d. of {' to '.join(ends)} times {100 * MASS_SD:.0f} % of each link's "
            f"mass and {1e3 * CENTER_SD:.0f} mm of its centre (0: CAD), by the marginal likelihood in "
            "training."
        )
    block = clusters(m)[rows]
    cad, offset = (np.concatenate(found[name]) for name in (CAD, CAD_WITH_OFFSET))
    for name, parts in found.items():
        residual = np.concatenate(parts)
        beats = None if name == CAD else _beats(cad, residual, block)
        beats_offset = None if name in (CAD, CAD_WITH_OFFSET) else _beats(offset, residual, block)
        rms = np.sqrt((residual**2).mean(axis=0))
        low, high = _interval(residual, block)
        scores.append(Score(name, split.name, _axes(rms), low, high, beats, beats_offset))


def _sums(values: np.ndarray, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums of values, (m, ...), over blocks, and their numbers of rows."""
    names, number = np.unique(block, return_inverse=True)
    sums = np.zeros((len(names), *values.shape[1:]))
    np.add.at(sums, number, values)
    return sums, np.bincount(number)


def _interval(residual: np.ndarray, block: np.ndarray) -> tuple[Axes | None, Axes | None]:
    """Return the ends of the 95 % interval of the r.m.s. by a bootstrap over blocks; None with too few."""
    sums, counts = _sums(residual**2, block)
    if len(counts) < LEAST_BLOCKS:
        return None, None
    drawn = np.random.default_rng(SEED).integers(len(counts), size=(RESAMPLES, len(counts)))
    rms = np.sqrt(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)[:, None])
    low, high = np.quantile(rms, [0.025, 0.975], axis=0)
    return _axes(low), _axes(high)


def _beats(cad: np.ndarray, residual: np.ndarray, block: np.ndarray) -> bool | None:
    """Tell whether a model's squared residuals are smaller than CAD's, by Student's t over blocks."""
    gain, counts = _sums((cad**2 - residual**2).sum(axis=1), block)
    if len(gain) < LEAST_BLOCKS or np.sqrt((cad**2).mean()) < HARMLESS:
        return None
    # Of a ratio of sums: blocks of many postures count for more.
    each = gain - counts * gain.sum() / counts.sum()
    error = np.sqrt(len(gain) / (len(gain) - 1) * (each**2).sum())
    half = float(t_ppf(0.975, len(gain) - 1)) * error
    return None if abs(gain.sum()) <= half else bool(gain.sum() > 0)


@one_blas_thread
def corrected_errors(
    problem: PredictionProblem, adopted: Sequence[EffectInstance], train: np.ndarray, test: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Return the residuals of what `identify` estimates, with its corrections, (n, 2) [m]; was it steady."""
    nominal, m = problem.observed.nominal, problem.observed.measurements
    data = regression(nominal.parameters, m.take(train), nominal.robot)
    observed, found = as_log_shows(with_cad_where_needed(problem.observed, data), rows=train)
    if found is None or adopted:
        found = self_calibrate(observed.take(train), effects=adopted)
    return center_errors(found, observed.take(test)), found.steady


def _with_prior(problem: PredictionProblem, train: np.ndarray, test: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the residuals of a posterior about CAD with an offset, (n, 2) [m], and the prior's scale.

    The scale, the noise and what is common to a placement maximise the marginal likelihood of the training
    postures, whose residuals are normal with covariance scale^2 H S S' H' + sigma^2 + tau^2 by placement.
    """
    residual = problem.residual[train].ravel()
    reach = _rows(problem.matrix, train) @ problem.spread
    offset = np.broadcast_to(np.eye(2), (len(problem.residual), 2, 2))
    every = np.concatenate([problem.zeros, WIDE * offset], axis=2)
    zeros = _rows(every, train)
    _, placement = np.unique(problem.observed.measurements.placement[train], return_inverse=True)
    shared = len(train) > placement.max() + 1
    common = np.kron(np.eye(placement.max() + 1)[placement], np.eye(2)) * shared
    # Beside the noise of single postures, the covariance is that of a few directions.
    basis, levers = np.linalg.qr(np.concatenate([reach, zeros, common], axis=1))
    widths = reach.shape[1], zeros.shape[1], common.shape[1]
    along = basis.T @ residual
    rest = residual - basis @ along
    size = float(np.sqrt((residual**2).mean()))

    def covariance(logs: np.ndarray) -> tuple[np.ndarray, float]:
        scale, sigma, tau = np.exp(2 * np.clip(logs, np.log(SMALLEST), [np.log(WIDEST), 10, 10]))
        return levers * np.repeat([scale, 1.0, tau], widths) @ levers.T + sigma * np.eye(len(along)), sigma

    def cost(logs: np.ndarray) -> float:
        inside, sigma = covariance(logs)
        if sigma < ROUNDING * inside.max():  # exact readings
            return np.inf
        root = np.linalg.cholesky(inside)
        white = np.linalg.solve(root, along)
        volume = 2 * np.log(np.diag(root)).sum() + (len(residual) - len(along)) * np.log(sigma)
        return float(volume + white @ white + rest @ rest / sigma)

    starts = [np.log([scale, size / 2, size / 2]) for scale in STARTS]
    options = {"xatol": 1e-3, "fatol": 1e-4, "maxiter": 400}
    best = min(
        (minimize(cost, s, method="Nelder-Mead", options=options) for s in starts), key=lambda r: r.fun
    )
    scale = float(np.exp(np.clip(best.x[0], np.log(SMALLEST), np.log(WIDEST))))
    inside, sigma = covariance(best.x)
    weights = basis @ np.linalg.solve(inside, along) + rest / sigma
    change = scale**2 * problem.spread @ (reach.T @ weights)
    shown = every[test] @ (zeros.T @ weights)
    return problem.residual[test] - problem.matrix[test] @ change - shown, scale


class PredictionProblem:
    """The data that the models have to explain.

    Attributes:
        observed: the measurements in the nominal laboratory.
        matrix: H, (m, 2, p). center: centre of pressure, (m, 2) [m]. residual: of CAD, (m, 2) [m].
        spread: root of the prior's covariance of the base parameters, (p, k) [m].
        zeros: change of the residual by one s.d. of sensors' zeros that are not known well, and of the
            weight if neither they nor a weighed mass tell it, (m, 2, z).
    """

    def __init__(self, m: Measurements, nominal: Nominal):
        self.observed = observe(m, nominal)
        self.matrix = -by_base_parameters(self.observed)[:, ROWS["A"]]  # with what they change in motion
        self.center, self.zeros = contact_pressure(self.observed).center, np.zeros((len(m), 2, 0))
        contacts = self.observed.contacts
        if contacts.zero_sd is not None and contacts.unknown is not None and contacts.unsure.any():
            sd = np.where(contacts.unknown, np.inf, contacts.zero_sd)
            self.center, self.zeros = _about_zeros(m, nominal, np.where(contacts.unsure, sd, 0.0))
        self.residual = self.center - nominal.center_of_mass(m.joint_angles, m.support)
        self.spread = cad_prior(nominal.parameters, standard_parameters(nominal.robot.model)).root


def _rows(values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the rows of a matrix (m, 2, k) for some postures, (2 n, k)."""
    return values[chosen].reshape(2 * len(chosen), -1)


def _about_zeros(m: Measurements, nominal: Nominal, zero_sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of pressure, (m, 2) [m], and its change by one s.d. of zeros, (m, 2, z).

    Vertical forces hold the zeros too. If nothing is known of these, the moments are divided by the weight of
    the nominal or weighed mass.

    Args:
        zero_sd: of each channel's zero, infinite if nothing is known of it, (2, c) [N, Nm].
    """

    def center(wrenches: np.ndarray) -> np.ndarray:
        stated = (nominal.mass, 0.0) if nominal_weight else m.weighed_mass
        return contact_pressure(observe(replace(m, wrenches=wrenches, weighed_mass=stated), nominal)).center

    assert m.wrenches is not None
    nominal_weight = m.weighed_mass is None and np.isinf(zero_sd).any()
    here, columns, weight = center(m.wrenches), [], []
    for side, channel in np.argwhere(zero_sd):
        zero = np.zeros(zero_sd.shape)
        zero[side, channel] = 1.0
        change, sd = center(m.wrenches + zero) - here, zero_sd[side, channel]
        if (size := float(np.sqrt((change**2).mean()))) > SMALLEST:
            columns.append(change * (sd if np.isfinite(sd) else WIDE / size))
    if nominal_weight:  # an error of the weight is no error of the CAD model's centre of mass
        mass = standard_parameters(nominal.robot.model)[:, 0]
        # By the moments that CAD expects: by the measured ones, any could be made to vanish.
        expected = nominal.center_of_mass(m.joint_angles, m.support)
        weight = [expected * MASS_SD * np.linalg.norm(mass) / mass.sum()]
    return here, np.stack([*columns, *weight], axis=2) if columns or weight else np.zeros((*here.shape, 0))

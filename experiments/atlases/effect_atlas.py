"""The atlas of a plan: which effects it would detect, distinguish or hide, before anything is measured."""

from dataclasses import replace

import numpy as np
import scipy

from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.discovery.candidates import candidates
from tulip_testbed.discovery.columns import CandidateColumns, candidate_columns
from tulip_testbed.discovery.detectability import POWER, detectable_size, single_level
from tulip_testbed.discovery.evidence import DETECTABLE, effective_tests
from tulip_testbed.discovery.selection import LEVEL
from tulip_testbed.effects.instance import MOST_PRIORS
from tulip_testbed.experiments.atlases.atlas_result import ISOLABLE, Atlas, AtlasRow, nearest_angles
from tulip_testbed.experiments.atlases.planned_experiment import BiasWeights, Planned, bias
from tulip_testbed.identification.distributions import chi2_isf, normal_isf
from tulip_testbed.identification.residual_channels import CHANNELS

SAME = 1e-9  # of the largest column: a choice that changes nothing


def atlas(planned: Planned, rng: np.random.Generator) -> Atlas:
    """Make it, with `rng` for the number of independent tests."""
    among = candidates(planned.observed)
    columns = candidate_columns(linear_model(planned.observed, planned.noise), among)
    single = {c: candidate_columns(linear_model(planned.observed, planned.noise, c), among) for c in CHANNELS}
    tests = effective_tests([columns], rng)
    level = single_level(LEVEL, tests)
    estimator, errors, owners, rows, changing = BiasWeights(planned), planned.standard_errors, [], [], []
    for k, candidate in enumerate(among):
        points = columns.projected[k]
        length = np.array([np.linalg.norm(column) for column in points])
        changes = length > SAME * length.max()
        changing.append([column for column, real in zip(points, changes, strict=True) if real])
        # The middle one of a time, the least visible one of a choice that changes anything.
        least = int(np.where(changes, length, np.inf).argmin())
        point = len(points) // 2 if candidate.effect.sizes else least
        moved = bias(planned, estimator, candidate, point)
        for size in range(len(candidate.effect.sizes)) or (None,):
            parameter = None if size is None else candidate.effect.parameters[candidate.effect.sizes[size]]
            prior, biases = 1.0 if size is None else float(candidate.prior[size]), moved[:, size or 0]
            least_size = _detectable(columns, k, point, size, level)
            at_least = biases * (least_size / prior if np.isfinite(least_size) else np.nan)
            owners.append(k)
            rows.append(
                AtlasRow(
                    effect=candidate.effect.name,
                    target=candidate.target or None,
                    parameter=None if parameter is None else parameter.name,
                    unit="" if parameter is None else parameter.unit,
                    prior_sd=None if parameter is None else prior,
                    detectable=least_size,
                    by_channel={c: _detectable(single[c], k, point, size, level) for c in CHANNELS},
                    visible=bool(np.linalg.norm(points[point][:, [size or 0]]) * prior > DETECTABLE),
                    bias_at_prior_m=biases,
                    bias_at_prior_se=biases / errors,
                    bias_at_detectable_se=at_least / errors,
                )
            )
    shown = sorted({k for k, row in zip(owners, rows, strict=True) if row.visible})
    angle = angles([changing[k] for k in shown])
    alike, names = groups(angle), [among[k].label for k in shown]
    others, apart = nearest_angles(angle)
    for at, k in enumerate(owners):
        if k in shown and len(shown) > 1:
            number = shown.index(k)
            rows[at] = replace(
                rows[at],
                nearest=names[others[number]],
                nearest_angle_rad=float(apart[number]),
                isolable=bool(apart[number] >= ISOLABLE),
                group=next((n for n, group in enumerate(alike, 1) if number in group), None),
            )
    return Atlas(
        preset=planned.sensors,
        seed=planned.seed,
        postures=len(planned.observed),
        planned=len(planned.plan),
        power=POWER,
        level=LEVEL,
        tests=tests,
        level_of_each=level,
        isolable_rad=ISOLABLE,
        parameters=planned.nominal.parameters.names,
        standard_error_m=errors,
        effects=tuple(rows),
        groups=tuple(tuple(names[k] for k in group) for group in alike),
        shown=tuple(names),
        angle_rad=angle,
        robot=planned.nominal.robot.name,
    )


def _detectable(columns: CandidateColumns, k: int, point: int, size: int | None, level: float) -> float:
    column = columns.projected[k][point]
    if size is None:
        # The gain 2 g'r - g'g has mean g'g and variance 4 g'g where the effect is there.
        length = float(np.linalg.norm(column))
        needed = chi2_isf(2 * level, 1)
        return 1.0 if length**2 - 2 * normal_isf(1 - POWER) * length > needed else np.inf
    candidate = columns.candidates[k]
    direction = (np.arange(column.shape[1]) == size).astype(float)
    least = detectable_size(candidate, column, level, direction)
    return least if least < MOST_PRIORS * candidate.prior[size] else np.inf


def angles(blocks: list[list[np.ndarray]]) -> np.ndarray:
    """Return the smallest angles between candidates' columns, (r, s) at a grid point, (n, n) [rad]."""
    owner = np.repeat(np.arange(len(blocks)), [len(points) for points in blocks])
    width = max(column.shape[1] for points in blocks for column in points)
    bases = np.zeros((len(owner), blocks[0][0].shape[0], width))
    for base, column in zip(bases, (c for points in blocks for c in points), strict=True):
        left, size, _ = np.linalg.svd(column, full_matrices=False)
        rank = int((size > 1e-6 * size.max(initial=0.0)).sum())
        base[:, :rank] = left[:, :rank]
    out = np.full((len(blocks), len(blocks)), np.pi / 2)
    for k in range(len(blocks)):
        mine = bases[owner == k]
        inner = np.einsum("arv,brw->abvw", mine, bases, optimize=True)
        cosine = np.linalg.norm(inner, ord=2, axis=(2, 3)).max(axis=0)
        for other in range(len(blocks)):
            out[k, other] = np.arccos(min(1.0, float(cosine[owner == other].max())))
    np.fill_diagonal(out, 0.0)
    return np.minimum(out, out.T)


def groups(angle: np.ndarray) -> list[list[int]]:
    """Candidates any two of which are closer than `ISOLABLE`, by complete linkage; the largest first."""
    if len(angle) < 2:
        return []
    near = scipy.spatial.distance.squareform(angle, checks=False)
    tree = scipy.cluster.hierarchy.linkage(near, "complete")
    label = scipy.cluster.hierarchy.fcluster(tree, ISOLABLE, "distance")
    alike = [np.flatnonzero(label == number).tolist() for number in np.unique(label)]
    return sorted((group for group in alike if len(group) > 1), key=lambda group: (-len(group), group))

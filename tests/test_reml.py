"""The restricted likelihood and predictive densities against dense formulas, differences and quadrature."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import approx_fprime, minimize
from scipy.stats import multivariate_normal

from tulip_testbed.calibration.family_spreads import LIMIT, WIDEST
from tulip_testbed.calibration.linear_problem import LinearProblem
from tulip_testbed.calibration.prediction import HeldOutPrediction
from tulip_testbed.calibration.reml import QUIETEST, bounded, fit, least_nearby, objective, parts_of_variance
from tulip_testbed.calibration.reml import given as fit_with
from tulip_testbed.identification.noise_structure import NoiseStructure, groups


def noise_of(fixed: np.ndarray, own: np.ndarray, shared: np.ndarray, free: np.ndarray) -> NoiseStructure:
    """Placements of three postures, each with a stance of two and one of a single posture."""
    m = len(fixed)
    stance = np.arange(m) // 3 * 2 + (np.arange(m) % 3 == 2)
    owner = np.full(shared.shape[2], len(own))
    return NoiseStructure(groups(np.arange(m) // 3), groups(stance), fixed, own, shared, owner, free)


def plain(columns: np.ndarray, flat: int, variance: np.ndarray, **more) -> LinearProblem:
    """Flat parameters, one family: columns and output (m, r, p + 1), covariance of white noise (m, r, r)."""
    m, r, members = *columns.shape[:2], columns.shape[2] - 1 - flat
    nothing = np.zeros((m, r, 0))
    choices: Any = {"excess": np.zeros((members, members)), "about": np.zeros(members)} | more
    return LinearProblem(
        whole=columns,
        flat=flat,
        noise=noise_of(variance, np.zeros((0, m, r, r)), nothing, nothing),
        information=np.zeros((flat, flat)),
        sizes=(members,),
        doubt=np.zeros(0),
        **choices,
    )


def problem(seed: int, postures: int = 15) -> LinearProblem:
    """Two residuals of each posture have a constant of its stance, one posture has no such residuals."""
    rng = np.random.default_rng(seed)
    p, rows, sizes = 4, 5, (5, 3, 1)
    q = sum(sizes)
    used = np.ones((postures, rows))
    used[4, :2] = 0
    factors = used[..., None] * rng.standard_normal((postures, rows, 6))
    levers = 0.5 * used[..., None] * rng.standard_normal((postures, rows, 2))
    free = used[..., None] * np.tile(np.eye(rows)[:, :2], (postures, 1, 1))
    own = factors @ factors.mT
    fixed = 0.01 * np.tile(np.eye(rows), (postures, 1, 1)) + (1 - used)[..., None] * np.eye(rows)
    columns, members = rng.standard_normal((postures, rows, p)), rng.standard_normal((postures, rows, q))
    members *= np.repeat([0.5, 1.5, 2.5], sizes)
    common = rng.standard_normal((postures // 3, 2))[np.arange(postures) // 3]
    noise = (factors @ rng.standard_normal((postures, 6, 1)) + levers @ common[..., None])[..., 0]
    noise += 0.1 * rng.standard_normal(noise.shape)
    phi = np.repeat([1, 0.05, 2], sizes) * rng.standard_normal(q)
    output = noise + columns @ rng.standard_normal(p) + members @ phi
    return LinearProblem(
        whole=used[..., None] * np.concatenate([columns, members, output[..., None]], axis=2),
        flat=p,
        noise=noise_of(fixed, own[None], levers, free),
        information=np.diag([0.0, 0.0, 0.0, 3.0]),
        sizes=sizes,
        doubt=np.array([0.7, np.log(4.0)]),
        excess=np.zeros((q, q)),
        about=np.zeros(q),
    )


def flat(values: np.ndarray) -> np.ndarray:
    return values.reshape(-1, *values.shape[2:])


def dense_covariance(given: LinearProblem, log_scale: np.ndarray, log_spread: np.ndarray) -> np.ndarray:
    """V of the rows, with a row for each known flat parameter at the end."""
    m, r = given.output.shape
    noise, scales = given.noise, np.exp(log_scale)
    full = np.zeros((m, r, m, r))
    for i in range(m):
        full[i, :, i] = noise.fixed[i]
        full[i, :, i] += np.tensordot(scales[: len(noise.own)] ** 2, noise.own[:, i], axes=1)
        for j in range(m):
            if noise.placement.number[i] == noise.placement.number[j]:
                full[i, :, j] += noise.shared[i] * scales[noise.owner] ** 2 @ noise.shared[j].T
    v = full.reshape(m * r, m * r)
    for part, size in zip(given.parts, np.exp(log_spread), strict=True):
        one = flat(given.members)[:, part] * size
        v = v + one @ one.T
    known = np.flatnonzero(np.diag(given.information))
    v = np.pad(v, ((0, len(known)), (0, len(known))))
    for k, column in enumerate(known):
        v[m * r + k, m * r + k] = 1 / given.information[column, column]
    return v


def dense_columns(given: LinearProblem) -> tuple[np.ndarray, np.ndarray]:
    """N with the constants of the stances beside it, which are flat parameters too, and y."""
    m, r = given.output.shape
    known = np.flatnonzero(np.diag(given.information))
    each = [
        np.where(given.noise.stance.number == number, given.noise.free[..., k].T, 0).T
        for number in np.unique(given.noise.stance.number)
        for k in range(given.noise.free.shape[2])
    ]
    stances = np.stack(each, axis=-1).reshape(m * r, -1) if each else np.zeros((m * r, 0))
    stances = stances[:, np.abs(stances).max(axis=0, initial=0.0) > 0]
    columns = np.concatenate([flat(given.columns), np.eye(given.columns.shape[2])[known]])
    columns = np.hstack([columns, np.pad(stances, ((0, len(known)), (0, 0)))])
    return columns, np.append(given.output.ravel(), np.zeros(len(known)))


def dense_objective(given: LinearProblem, log_scale: np.ndarray, log_spread: np.ndarray) -> float:
    v = dense_covariance(given, log_scale, log_spread)
    n, y = dense_columns(given)
    inner = n.T @ np.linalg.solve(v, n)
    rest = y - n @ np.linalg.solve(inner, n.T @ np.linalg.solve(v, y))
    many = np.log1p(np.exp(2 * log_spread[0])) - log_spread[0]  # five members; the others are few
    prior = (
        0.5 * ((log_scale / given.doubt) ** 2).sum() + many + 0.5 * ((log_spread[1:] / np.log(2)) ** 2).sum()
    )
    return (
        0.5 * (np.linalg.slogdet(v)[1] + np.linalg.slogdet(inner)[1] + rest @ np.linalg.solve(v, rest))
        + prior
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_objective_is_that_of_the_dense_covariance(seed):
    given = problem(seed)
    rng = np.random.default_rng(seed)
    points = [(0.3 * rng.standard_normal(2), rng.standard_normal(3) - 1) for _ in range(4)]
    fast = [objective(given, *point)[0] for point in points]
    dense = [dense_objective(given, *point) for point in points]
    assert np.diff(fast) == pytest.approx(np.diff(dense), abs=1e-8)  # up to one constant


def test_the_gradient_is_that_of_finite_differences():
    given = problem(4)
    for point in (np.array([0.2, -0.1, 0.3, -1.0, 0.1]), np.array([0.0, 0.0, -6.0, -6.0, 2.0])):
        slope = approx_fprime(point, lambda x: objective(given, x[:2], x[2:])[0], 1e-6)
        assert objective(given, point[:2], point[2:])[1] == pytest.approx(slope, abs=2e-4)


@pytest.mark.parametrize("seed", range(4))
def test_the_fit_is_the_minimum(seed):
    given = problem(10 + seed)
    found = fit(given)
    by_scipy = minimize(
        lambda x: objective(given, x[:2], x[2:]), np.zeros(5), jac=True, method="BFGS", options={"gtol": 1e-7}
    )
    assert found.value <= by_scipy.fun + 2e-3
    at = np.log(np.concatenate([found.scales, found.spreads]))
    slope = objective(given, at[:2], at[2:])[1]
    assert slope @ found.scale_covariance @ slope < 2e-3  # what a step of Newton's would still gain
    again = fit(given, (found.scales, found.spreads))
    assert again.estimate == pytest.approx(found.estimate, rel=2e-2, abs=1e-2)


@pytest.mark.parametrize("seed", [3, 4])
def test_a_spread_at_its_limit_does_not_hold_up_the_others(seed):
    """Members in units of a hundredth: their families want more than the widest spread."""
    given = problem(seed)
    members = np.repeat([1.0, 0.01, 1.0], [given.flat, sum(given.sizes), 1])
    given = dataclasses.replace(given, whole=given.whole * members)
    found = fit(given)
    assert found.spreads.max() == pytest.approx(np.exp(WIDEST))
    at = np.log(np.concatenate([found.scales, found.spreads]))
    by_scipy = minimize(
        lambda x: objective(given, x[:2], x[2:]),
        at,
        jac=True,
        method="L-BFGS-B",
        bounds=[(QUIETEST, LIMIT)] * 2 + [(-LIMIT, WIDEST)] * 3,
    )
    assert found.value <= by_scipy.fun + 2e-3


@pytest.mark.parametrize("seed", range(4))
def test_near_the_mode_the_least_value_is_foretold(seed):
    """From scales and spreads that are off by 20 %, the step that is left out would gain 0.04 to 0.07."""
    given = problem(seed)
    best = fit(given)
    value, _ = least_nearby(given, (1.2 * best.scales, 0.8 * best.spreads))
    assert value == pytest.approx(best.value, abs=0.005)


@pytest.mark.parametrize("seed", range(4))
def test_steps_are_made_only_where_they_may_win(seed):
    """From scales and spreads that are off by a factor of two the least value is 16 to 18 lower."""
    given = problem(seed)
    best = fit(given)
    start = 2 * best.scales, 0.5 * best.spreads
    for beat, steps in ((best.value + 1, True), (best.value - 30, False)):
        value, (scales, _) = least_nearby(given, start, beat)
        assert (scales != pytest.approx(start[0])) == steps
        assert (value < beat) == steps
        assert value == pytest.approx(best.value, abs=0.1 if steps else 10)


def test_the_doubt_of_a_scale_against_its_prior_is_that_of_the_curvature():
    """Placements share noise of three times its sheet: readings and sheet pull the scale apart."""
    given = problem(6, postures=60)
    given = dataclasses.replace(given, noise=dataclasses.replace(given.noise, shared=given.noise.shared / 3))
    given = dataclasses.replace(given, doubt=np.array([0.7, 0.1]))
    found = fit(given)
    at = np.log(np.concatenate([found.scales, found.spreads]))
    slope = [
        np.subtract(*(objective(given, *np.split(at + e, [2]))[1] for e in (d, -d))) for d in 1e-4 * np.eye(5)
    ]
    assert np.sqrt(np.diag(found.scale_covariance)[:2]) == pytest.approx(
        np.sqrt(np.diag(np.linalg.inv(np.array(slope) / 2e-4))[:2]), rel=0.02
    )


def test_the_estimate_is_generalised_least_squares_with_the_dense_covariance():
    given = problem(20)
    found = fit(given)
    v = dense_covariance(given, np.log(found.scales), np.log(found.spreads))
    n, y = dense_columns(given)
    inner = np.linalg.inv(n.T @ np.linalg.solve(v, n))
    nu = inner @ n.T @ np.linalg.solve(v, y)
    p = given.flat
    assert found.estimate[:p] == pytest.approx(nu[:p])
    assert found.conditional[:p, :p] == pytest.approx(inner[:p, :p])
    assert parts_of_variance(given, found).sum(axis=0) == pytest.approx(inner[:p, :p])
    d = np.diag(np.repeat(found.spreads**2, given.sizes))
    known = len(y) - given.output.size
    g = np.pad(flat(given.members), ((0, known), (0, 0)))
    assert found.estimate[p:] == pytest.approx(d @ g.T @ np.linalg.solve(v, y - n @ nu))
    by_scales = found.covariance - found.conditional
    assert np.linalg.eigvalsh(by_scales).min() > -1e-10


def test_the_derivative_of_the_estimate_by_the_scales():
    """What the covariance adds for uncertain scales, by finite differences of the dense estimate."""
    given = problem(21)
    found = fit(given)
    at = np.log(np.concatenate([found.scales, found.spreads]))
    n, y = dense_columns(given)

    def nu(x: np.ndarray) -> np.ndarray:
        v = dense_covariance(given, x[:2], x[2:])
        return np.linalg.solve(n.T @ np.linalg.solve(v, n), n.T @ np.linalg.solve(v, y))

    slope = np.array([(nu(at + e) - nu(at - e))[: given.flat] / 2e-5 for e in 1e-5 * np.eye(5)]).T
    p = given.flat
    added = (found.covariance - found.conditional)[:p, :p]
    assert added == pytest.approx(slope @ found.scale_covariance @ slope.T, rel=1e-4, abs=1e-10)


def test_a_family_that_nothing_shows_has_spread_one():
    given = problem(5)
    whole = given.whole.copy()
    whole[..., 9:12] = given.columns[..., :3]  # as flat parameters: nothing can tell them apart
    found = fit(dataclasses.replace(given, whole=whole))
    assert found.spreads[1] == pytest.approx(1.0, abs=1e-3)
    assert found.conditional[9:12, 9:12] == pytest.approx(np.eye(3), rel=1e-5, abs=1e-9)


def test_what_no_residual_shows_changes_nothing():
    """Residuals that no posture uses, and members without columns in a family of known spread, are added."""
    given = problem(8)
    rows, members = given.whole.shape[1], given.flat + 9
    whole = np.insert(given.whole, members, np.zeros((2, 1, 1)), axis=2)
    whole = np.insert(whole, [1, rows], 0.0, axis=1)
    noise = {
        name: np.insert(getattr(given.noise, name), [1, rows], 0.0, axis=axis)
        for name, axis in (("shared", 1), ("free", 1), ("fixed", 1), ("own", 2))
    }
    noise = {
        name: value if name in ("shared", "free") else np.insert(value, [1, rows], 0.0, axis=-1)
        for name, value in noise.items()
    }
    noise["fixed"][:, [1, -1], [1, -1]] = 1.0
    larger = dataclasses.replace(
        given,
        whole=whole,
        sizes=(*given.sizes[:2], 3),
        noise=dataclasses.replace(given.noise, **noise),
        excess=np.zeros((11, 11)),
        about=np.zeros(11),
        known=(2,),
    )
    small, shown = larger.in_use()
    assert small.whole.shape == given.whole.shape
    assert np.flatnonzero(~shown).tolist() == [members, members + 1]
    found, plain = fit(larger), fit(dataclasses.replace(given, known=(2,)))
    assert found.log_evidence == pytest.approx(plain.log_evidence, abs=1e-9)
    assert found.estimate[shown] == pytest.approx(plain.estimate)
    assert found.covariance[np.ix_(shown, shown)] == pytest.approx(plain.covariance)
    assert not found.estimate[~shown].any()
    assert np.diag(found.covariance)[~shown] == pytest.approx(1.0)


def test_marginal_posterior_of_a_member_by_quadrature():
    """Mean and s.d. of a member against the integral over its family's spread, nothing else unknown."""
    rng = np.random.default_rng(7)
    members = rng.standard_normal((1, 12, 4))
    output = members @ np.array([0.5, -0.8, 0.4, 0.9]) + 0.5 * rng.standard_normal((1, 12))
    columns = np.concatenate([np.ones((1, 12, 1)), members, output[..., None]], axis=2)
    given = plain(columns, 1, 0.25 * np.eye(12)[None])
    found = fit(given)
    grid = np.linspace(-6, 4, 400)
    log_posterior, means, variances = [], [], []
    for x in grid:
        value = -objective(given, np.zeros(0), np.array([x]))[0]
        d = np.exp(2 * x)
        g, n = members[0], np.ones((12, 1))
        z = np.hstack([n, g])
        omega = np.linalg.inv(z.T @ z / 0.25 + np.diag([0, *[1 / d] * 4]))
        mean = omega @ z.T @ given.output[0] / 0.25
        log_posterior.append(value)
        means.append(mean[1:])
        variances.append(np.diag(omega)[1:])
    weight = np.exp(np.array(log_posterior) - max(log_posterior))
    weight /= weight.sum()
    mean = weight @ np.array(means)
    sd = np.sqrt(weight @ (np.array(variances) + np.array(means) ** 2) - mean**2)
    assert found.estimate[1:] == pytest.approx(mean, abs=0.15 * sd.max())
    assert np.sqrt(np.diag(found.covariance)[1:]) == pytest.approx(sd, rel=0.1)


@pytest.mark.slow
def test_noise_in_a_column_does_not_draw_its_member_to_zero():
    """Many small experiments with a noisy column: the corrected information gives the member on average."""
    rng = np.random.default_rng(1)
    errors = {0.0: [], 1.0: []}
    for _ in range(100):
        true = rng.standard_normal((1, 200, 1))
        noisy = true + 0.7 * rng.standard_normal(true.shape)
        y = 3.0 * true[..., 0] + 0.3 * rng.standard_normal((1, 200))
        for share in errors:
            whole = np.concatenate([np.ones((1, 200, 1)), 100.0 * noisy, y[..., None]], axis=2)
            excess = np.array([[share * 0.49 * 199 * 100.0**2]])
            one = plain(whole, 1, np.eye(200)[None], excess=excess)
            errors[share].append(100.0 * fit_with(one, np.ones(0), np.ones(1)).estimate[1] - 3.0)
    assert np.mean(errors[0.0]) < -0.9
    assert abs(np.mean(errors[1.0])) < 0.1


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_errors_of_a_member_are_as_large_as_stated_however_noisy_its_column(share):
    """Three or eight tenths of the information are noise, about an estimate that is right."""
    rng = np.random.default_rng(2)
    true, off = 0.02 * np.sqrt(1 - share), []
    for _ in range(300):
        column = true + 0.02 * np.sqrt(share) * rng.standard_normal((3000, 1))
        left = rng.standard_normal((3000, 1))
        excess = np.array([[share * 3000 * 0.02**2]])
        whole, variance = np.stack([column, left + column], axis=2), np.ones((3000, 1, 1))
        one = plain(whole, 0, variance, excess=excess, about=np.ones(1))
        found = fit_with(one, np.ones(0), 10 * np.ones(1))
        off.append((found.estimate[0] - 1.0) / np.sqrt(found.covariance[0, 0]))
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1.0, abs=0.12)


def test_the_evidence_does_not_depend_on_what_flat_parameters_take_up():
    """A restricted likelihood is that of contrasts; far away the sums of squares lose all their digits."""
    given = problem(6)
    far = given.whole.copy()
    far[..., -1] += 1e9 * given.columns[..., 0]
    near, found = (fit_with(dataclasses.replace(given, whole=whole), np.ones(2), np.ones(3))
                   for whole in (given.whole, far))  # fmt: skip
    assert found.log_evidence == pytest.approx(near.log_evidence, abs=1e-3)


@pytest.mark.parametrize("most", [0.5, 0.9])
def test_the_excess_is_bounded_in_every_direction(most):
    """By square roots of the whole information, of an excess of both signs in some of the members."""
    rng = np.random.default_rng(0)
    root = rng.standard_normal((6, 6))
    information, excess = root @ root.T, np.zeros((6, 6))
    part = rng.standard_normal((3, 3))
    excess[np.ix_([1, 2, 4], [1, 2, 4])] = part + part.T
    values, axes = np.linalg.eigh(information)
    half = (axes * np.sqrt(values)) @ axes.T
    share, turn = np.linalg.eigh(np.linalg.solve(half, np.linalg.solve(half, excess).T))
    assert share[-1] > 0.9 == problem(1).most_excess
    expected = half @ (turn * np.minimum(share, most)) @ turn.T @ half
    np.testing.assert_allclose(bounded(excess, information, most), expected, atol=1e-12)
    small = 0.4 / share[-1] * excess
    np.testing.assert_array_equal(bounded(small, information, most), small)


@pytest.mark.parametrize("channels", ["A", "AT", "ATC"])
def test_density_and_chi_square_are_those_of_the_dense_covariance(channels):
    rng = np.random.default_rng(2)
    sizes, unit = (5, 3, 7), 10.0 ** rng.uniform(-4, 2, 15)
    factors = [rng.standard_normal((n, n)) for n in sizes]
    ends = np.cumsum(sizes)[:-1]
    noise = tuple(
        (factor @ factor.T + np.eye(len(factor))) * np.outer(part, part)
        for factor, part in zip(factors, np.split(unit, ends), strict=True)
    )
    estimates = 3 * unit[:, None] * rng.standard_normal((15, 4))
    channel = np.array(list("ATCATACCTTTAAAC"))
    whole = HeldOutPrediction(unit * rng.standard_normal(15), channel, noise, estimates)
    found, rows = whole.of(channels), np.isin(channel, list(channels))
    covariance = (block_diag(*noise) + estimates @ estimates.T)[np.ix_(rows, rows)]
    scaled = covariance / np.outer(unit[rows], unit[rows])
    dense = multivariate_normal(np.zeros(rows.sum()), scaled)
    expected = dense.logpdf(whole.residual[rows] / unit[rows]) - np.log(unit[rows]).sum()
    assert found.log_density == pytest.approx(expected)
    inverse = np.linalg.solve(scaled, found.residual / unit[rows])
    assert found.chi_square == pytest.approx(inverse @ (found.residual / unit[rows]))
    assert found.variance == pytest.approx(np.diag(covariance))

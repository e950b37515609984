"""The nearest consistent robot, against solutions that share nothing with it."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.cad_prior import CENTER_SD, MASS_SD, expected_standard
from tulip_testbed.identification.consistent_robot import Target, consistent_robot, data_shares
from tulip_testbed.identification.pseudo_inertia import (
    at_standard,
    bounding_ellipsoids,
    central,
    pseudo_inertia,
    pseudo_inertias,
    solid,
    standard_of,
)
from tulip_testbed.sim.random_robots import draw_robot

ERROR = 1e-3  # m: standard error of every base parameter


def cad_of(robot):
    reference = solid(pseudo_inertias(robot.model))
    return SimpleNamespace(
        robot=robot,
        reference=reference,
        ellipsoids=bounding_ellipsoids(robot.visual_model, reference),
        parameters=base_parameters(robot),
    )


@pytest.fixture(scope="module")
def cads(robot, foreign):
    return [cad_of(one) for one in (robot, *foreign.values())]


@pytest.fixture(scope="module")
def cad(cads):
    return cads[0]


def target(cad, standard):
    count = len(cad.parameters.names)
    value = cad.parameters.values(standard)
    return Target(cad.parameters.from_standard, value, ERROR**2 * np.eye(count), standard[:, 0].sum())


def check(cad, wanted, found):
    """Everything that must hold of any consistent robot, by plain arithmetic."""
    heavy = found.pseudo[:, 3, 3] > 0
    assert heavy.tolist() == (cad.robot.model.body_mass[1:] > 0).tolist()
    for one, bound in zip(found.pseudo[heavy], cad.ellipsoids[heavy], strict=True):
        assert np.linalg.eigvalsh(one).min() > 0
        mass, _, inertia = central(one)
        moments = np.linalg.eigvalsh(inertia)
        assert mass > 0
        assert moments[0] > 0
        assert moments[0] + moments[1] > moments[2]
        assert np.trace(bound @ one) > -1e-9 * mass
    standard = standard_of(found.pseudo)
    assert np.abs(cad.parameters.values(standard) - found.value).max() < 1e-11
    assert standard[:, 0].sum() == pytest.approx(wanted.mass, rel=1e-11)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**32 - 1))
def test_random_robots_have_a_consistent_one(cads, seed):
    rng = np.random.default_rng(seed)
    cad = cads[rng.integers(len(cads))]
    wanted = target(cad, draw_robot(cad.robot.model, 0.2, rng))
    found = consistent_robot(cad.reference, cad.ellipsoids, wanted)
    assert found.misfit == 0
    assert np.array_equal(found.value, wanted.value)
    check(cad, wanted, found)


def test_the_estimate_of_cad_gives_cad(cad):
    found = consistent_robot(cad.reference, cad.ellipsoids, target(cad, standard_parameters(cad.robot.model)))
    assert np.abs(found.pseudo - cad.reference).max() < 1e-12


def test_pseudo_inertia_of_point_masses():
    """Against the definition: the integral of [x; 1] [x; 1]' over point masses."""
    rng = np.random.default_rng(5)
    mass, points = rng.uniform(0.1, 1, 9), rng.normal(size=(9, 3))
    whole = np.column_stack([points, np.ones(9)])
    expected = (whole * mass[:, None]).T @ whole
    center = mass @ points / mass.sum()
    arms = points - center
    each = [m * (a @ a * np.eye(3) - np.outer(a, a)) for m, a in zip(mass, arms, strict=True)]
    inertia = np.sum(each, axis=0)
    found = pseudo_inertia(mass.sum(), center, inertia)
    assert np.abs(found - expected).max() < 1e-13
    for a, b in zip(central(found), (mass.sum(), center, inertia), strict=True):
        assert np.abs(a - b).max() < 1e-13


def test_projection_against_a_search_over_cholesky_factors():
    """Of two links, by SciPy's SLSQP, with P = L L' and the divergence written out."""
    rng = np.random.default_rng(3)
    inertia = np.diag([3.0, 4, 5]) / 100
    reference = np.array([pseudo_inertia(m, rng.normal(size=3) / 10, inertia * m) for m in (2, 1)])
    from_standard = np.array([[0.0, 1, 0, 0, 0.3, 1, 0, 0], [0, 0, 1, 0, 0, 0, 0, 1]])
    everywhere = np.array([np.diag([-1e-6, -1e-6, -1e-6, 1.0])] * 2)
    standard = reference[:, 3, [3, 0, 1, 2]]
    mass = 3.3
    value = from_standard @ standard.ravel() / 3 + [0.05, -0.03]
    found = consistent_robot(reference, everywhere, Target(from_standard, value, np.eye(2), mass))
    lower = np.tril_indices(4)

    def pseudo(x):
        roots = np.zeros((2, 4, 4))
        roots[:, lower[0], lower[1]] = x.reshape(2, 10)
        return roots @ roots.mT

    def divergence(x):
        ratio = np.linalg.solve(reference, pseudo(x))
        return (np.trace(ratio, axis1=1, axis2=2) - np.log(np.linalg.det(ratio)) - 4).sum()

    def lack(x):
        moved = pseudo(x)[:, 3, [3, 0, 1, 2]]
        return [*(from_standard @ moved.ravel() - mass * value), moved[:, 0].sum() - mass]

    start = np.linalg.cholesky(reference)[:, lower[0], lower[1]].ravel()
    solved = scipy.optimize.minimize(
        divergence, start, constraints={"type": "eq", "fun": lack}, options={"ftol": 1e-15, "maxiter": 500}
    )
    assert np.abs(lack(solved.x)).max() < 1e-9
    assert np.abs(pseudo(solved.x) - found.pseudo).max() < 1e-5 * np.abs(found.pseudo).max()
    own = np.linalg.cholesky(found.pseudo)[:, lower[0], lower[1]].ravel()
    assert divergence(own) <= divergence(solved.x) + 1e-9
    assert divergence(own) > 0.01


def nearest_by_point_masses(cad, wanted):
    """Distance of the nearest robot with all mass inside the ellipsoids, by non-negative least squares.

    Such a robot is many point masses on the ellipsoids' surfaces; a dense cloud misses it by little.
    """
    rng = np.random.default_rng(0)
    clouds, rows = [], wanted.from_standard.reshape(len(wanted.value), -1, 4)
    for k, bound in enumerate(cad.ellipsoids):
        if cad.reference[k, 3, 3] <= 0:
            continue
        shape = -bound[:3, :3]
        middle = np.linalg.solve(shape, bound[:3, 3])
        ball = rng.normal(size=(600, 3))
        ball /= np.linalg.norm(ball, axis=1, keepdims=True)
        points = middle + ball @ np.linalg.inv(np.linalg.cholesky(shape))
        clouds.append(rows[:, k] @ np.column_stack([np.ones(600), points]).T)
    reachable = np.hstack(clouds)
    away = (reachable - wanted.value[:, None]) / ERROR
    size = np.abs(away).max()
    stacked = np.vstack([away / size, np.full(away.shape[1], 1e4)])
    weights, _ = scipy.optimize.nnls(stacked, np.append(np.zeros(len(away)), 1e4), maxiter=20000)
    return float(np.linalg.norm(away @ weights / weights.sum()))


@pytest.mark.parametrize("number", [2, 5, 13])
def test_an_inconsistent_estimate_gives_the_nearest(cad, number):
    wanted = target(cad, standard_parameters(cad.robot.model))
    wanted.value[number - 1] += 50 * ERROR
    found = consistent_robot(cad.reference, cad.ellipsoids, wanted)
    check(cad, wanted, found)
    distance = np.linalg.norm((found.value - wanted.value) / ERROR)
    assert found.misfit == pytest.approx(distance, rel=1e-9)
    assert 1 < found.misfit < 50
    # A cloud of points reaches a little less than the ellipsoid; ours keeps a hundredth of CAD in every link.
    assert found.misfit == pytest.approx(nearest_by_point_masses(cad, wanted), abs=0.15)


def test_data_shares(cad):
    """Numbers that the data determine or cannot reach, told from what they are."""
    shares = data_shares(cad.reference, cad.parameters.from_standard)
    assert ((shares >= 0) & (shares <= 1 + 1e-12)).all()
    alone = data_shares(cad.reference, np.zeros((1, 4 * len(shares))))  # the total mass alone
    heavy = cad.reference[:, 3, 3] ** 2
    assert alone[:, 0] == pytest.approx(heavy / heavy.sum(), rel=1e-9)  # Var m_i is in proportion to m_i^2
    every = data_shares(cad.reference, np.eye(4 * len(shares)))
    assert every == pytest.approx(np.ones_like(every), abs=1e-9)
    # The total mass, as uncertain as by CAD: of a variance MASS_SD^2 sum m_i^2 half is left.
    doubtful = data_shares(
        cad.reference, np.zeros((1, 4 * len(shares))), np.diag([0, MASS_SD**2 * heavy.sum()])
    )
    assert doubtful[:, 0] == pytest.approx(alone[:, 0] / 2, rel=1e-9)


def test_the_prior_expects_what_a_regression_on_many_robots_says(cads):
    """Links whose base parameters are known, against the least squares of robots drawn from the prior."""
    cad, rng = cads[0], np.random.default_rng(3)
    by_cad = standard_parameters(cad.robot.model)
    drawn = np.tile(by_cad, (40000, 1, 1))
    drawn[..., 1:] += by_cad[:, :1] * CENTER_SD * rng.standard_normal(drawn[..., 1:].shape)
    drawn += MASS_SD * rng.standard_normal(drawn.shape[:2])[..., None] * by_cad
    shown = np.concatenate(
        [drawn.reshape(40000, -1) @ cad.parameters.from_standard.T, drawn[..., :1].sum(axis=1)], axis=1
    )
    columns = np.column_stack([np.ones(40000), shown])
    slopes = np.linalg.lstsq(columns, drawn.reshape(40000, -1), rcond=1e-10)[0]
    mass = shown[0, -1]
    expected = expected_standard(cad.parameters, by_cad, shown[0, :-1] / mass, mass)
    assert expected == pytest.approx((columns[0] @ slopes).reshape(-1, 4), abs=0.06)
    assert np.abs(expected - by_cad).max() > 0.3


def test_a_link_of_the_same_shape_has_other_mass_and_centre(cads):
    cad, rng = cads[0], np.random.default_rng(4)
    wanted = standard_parameters(cad.robot.model)
    wanted = wanted * rng.uniform(0.5, 2, (len(wanted), 1)) + 0.01 * wanted[:, :1] * [0, 1, 0, 0]
    changed = at_standard(cad.reference, wanted)
    for before, after, standard in zip(cad.reference, changed, wanted, strict=True):
        (old, _, inertia), (mass, center, new) = central(before), central(after)
        assert [mass, *(mass * center)] == pytest.approx(standard)
        assert new == pytest.approx(mass / old * inertia)

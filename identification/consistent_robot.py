"""The physically consistent robot that has given base parameters and is otherwise nearest to CAD.

Statics sees the base parameters and the total mass alone, which are linear in the links' masses and first
moments. Of all robots that have them, this is the one with the least divergence from CAD

    sum over links of  tr(P0^-1 P) - log det(P0^-1 P) - 4,

the Bregman divergence of -log det between pseudo-inertias, which does not depend on frames or units (Lee,
Wensing and Park 2020, "Geometric robot dynamic identification: a convex programming approach"). The mass of
every link lies in its ellipsoid (`pseudo_inertia.bounding_ellipsoids`): positive definite pseudo-inertias
alone would put a centre of mass anywhere.
"""

import warnings
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.cad_prior import MASS_SD

RANK = 1e-10  # of the largest singular value
STEPS = 200  # of Newton's method
ROUNDS = 30  # of the active set
CONVERGED = 1e-14  # of the right-hand side
SHORTEST = 1e-9  # step of the line search
FARTHEST = 20.0  # mean divergence of a link from CAD; farther robots are sought by the conic program first
NEGLIGIBLE = 1e-3  # standard errors
FAR = "found base parameters that no physically consistent robot has"
LEAST = 0.01  # of CAD's pseudo-inertia that every link of the nearest robot keeps


@dataclass(frozen=True, eq=False)
class Target:
    """The properties that a robot must have.

    Attributes:
        from_standard: see `BaseParameters`, (p, 4 n_links).
        value, covariance: estimate of the base parameters, (p,) [m] and (p, p) [m2].
        mass: of the whole robot [kg].
    """

    from_standard: np.ndarray
    value: np.ndarray
    covariance: np.ndarray
    mass: float


@dataclass(frozen=True, eq=False)
class ConsistentRobot:
    """A physically consistent robot.

    Attributes:
        pseudo: pseudo-inertias of the links, (n_links, 4, 4).
        value: its base parameters, (p,) [m]: the estimate's, or the nearest that a consistent robot has.
        misfit: distance of `value` from the estimate, sqrt(d' C^-1 d) [standard errors]; 0: none.
    """

    pseudo: np.ndarray
    value: np.ndarray
    misfit: float


def consistent_robot(reference: np.ndarray, ellipsoids: np.ndarray, target: Target) -> ConsistentRobot:
    """Find the consistent robot with the target's base parameters that is nearest to CAD.

    If no consistent robot has them, it is one with the nearest base parameters in the metric of their
    covariance, in which every link keeps a hundredth of CAD's pseudo-inertia.

    Args:
        reference: CAD's pseudo-inertias, (n_links, 4, 4), positive definite; zero for a link without mass.
        ellipsoids: of `bounding_ellipsoids`, (n_links, 4, 4).
    """
    if (found := robot_with(reference, ellipsoids, target)) is not None:
        return found
    space = _space(reference, target.from_standard)
    value, misfit = _nearest_value(space, _bounds(space, ellipsoids), target)
    for goal, away in ((target.value, 0.0), (value, misfit)) if misfit < NEGLIGIBLE else ((value, misfit),):
        if (found := robot_with(reference, ellipsoids, replace(target, value=goal), np.inf)) is not None:
            return replace(found, misfit=away)
    raise InputError(f"{FAR}, and the search for the nearest ones did not converge")


def robot_with(
    reference: np.ndarray, ellipsoids: np.ndarray, target: Target, farthest: float = FARTHEST
) -> ConsistentRobot | None:
    """Find the consistent robot with exactly these base parameters nearest to CAD, or None.

    A mean divergence of the links beyond `farthest` counts as none; see `consistent_robot` for the others.
    """
    space = _space(reference, target.from_standard)
    wanted = np.append(target.mass * target.value, target.mass)
    found = _nearest_to_reference(space, _bounds(space, ellipsoids), wanted, farthest)
    if found is None:
        return None
    pseudo, whole = np.zeros_like(reference), space.roots @ found @ space.roots.mT
    pseudo[space.heavy] = (whole + whole.mT) / 2
    return ConsistentRobot(pseudo, target.value, 0.0)


def data_shares(
    pseudo: np.ndarray, from_standard: np.ndarray, covariance: np.ndarray | None = None
) -> np.ndarray:
    """Return how much of each link's mass and centre the data determine, (n_links, 4): 0 CAD to 1 data.

    In the metric of the divergence's Hessian, tr(P^-1 dP P^-1 dP), it is the squared norm of the part of the
    number's gradient that base parameters and total mass span, over the squared norm of the whole gradient.
    A number whose standard error exceeds what CAD leaves open is not from data: the share is times the part
    of CAD's variance in both. A link without mass has zeros.

    Args:
        pseudo: of the robot, (n_links, 4, 4).
        covariance: of the base parameters times the total mass, and of the total mass, (p + 1, p + 1); None:
            they are exact.
    """
    space = _space(pseudo, from_standard)
    count = len(space.basis)
    noise = np.zeros((count, count)) if covariance is None else space.onto @ covariance @ space.onto.T
    shares = np.zeros((len(pseudo), 4))
    for k, link in enumerate(space.heavy):
        mass = pseudo[link, 3, 3]
        weights = np.zeros((4, 4))  # of [h, m]: mass, then the centre's coordinates
        weights[0, 3] = 1.0
        weights[1:, :3] = np.eye(3) / mass
        weights[1:, 3] = -pseudo[link, :3, 3] / mass**2
        gradient = _symmetric(space.roots[k], weights).reshape(4, 16)
        along = gradient @ space.basis[:, k].reshape(count, 16).T
        square, errors = (along**2).sum(axis=1), np.einsum("ij,jk,ik->i", along, noise, along)
        known = square / np.maximum(square + errors / MASS_SD**2, 1e-300)
        shares[link] = known * square / (gradient**2).sum(axis=1)
    return shares


@dataclass(frozen=True, eq=False)
class _Space:
    """Robots X as multiples of the reference, P = L X L' with the reference L L'; X = 1 is the reference.

    Attributes:
        heavy: links with mass, (h,).
        roots: L of each, (h, 4, 4).
        rows: base parameters times the mass and total mass are <rows, X>, (p + 1, h, 4, 4).
        basis: orthonormal matrices that span them, (k, h, 4, 4).
        onto: <basis, X> = onto @ <rows, X>, (k, p + 1).
    """

    heavy: np.ndarray
    roots: np.ndarray
    rows: np.ndarray
    basis: np.ndarray
    onto: np.ndarray


def _space(reference: np.ndarray, from_standard: np.ndarray) -> _Space:
    heavy = np.flatnonzero(reference[:, 3, 3] > 0)
    roots = np.linalg.cholesky(reference[heavy])
    weights = _weights(from_standard, heavy)
    rows = np.stack([_symmetric(root, weights[:, k]) for k, root in enumerate(roots)], axis=1)
    left, size, turned = np.linalg.svd(rows.reshape(len(rows), -1), full_matrices=False)
    kept = size > RANK * size[0]
    return _Space(
        heavy=heavy,
        roots=roots,
        rows=rows,
        basis=turned[kept].reshape(-1, len(heavy), 4, 4),
        onto=left[:, kept].T / size[kept, None],
    )


def _bounds(space: _Space, ellipsoids: np.ndarray) -> np.ndarray:
    """Return Q with <Q, X> >= 0 where the links lie in their ellipsoids, (h, 4, 4), of norm 1."""
    bounds = space.roots.mT @ ellipsoids[space.heavy] @ space.roots
    return bounds / np.linalg.norm(bounds, axis=(1, 2), keepdims=True)


def _weights(from_standard: np.ndarray, heavy: np.ndarray) -> np.ndarray:
    """Return the weights of [h, m] of the links with mass, (p + 1, h, 4); the last row is the total mass."""
    by_link = from_standard.reshape(len(from_standard), -1, 4)[:, heavy][..., [1, 2, 3, 0]]
    total = np.zeros((1, len(heavy), 4))
    total[..., 3] = 1.0
    return np.concatenate([by_link, total])


def _symmetric(root: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return symmetric matrices G with <G, X> = w' P e_4, P = L X L', for each row w of the weights."""
    product = (weights @ root)[:, :, None] * root[3]
    return (product + product.mT) / 2


def _nearest_to_reference(
    space: _Space, ellipsoids: np.ndarray, wanted: np.ndarray, farthest: float
) -> np.ndarray | None:
    """Return X nearest to 1 with <rows, X> = wanted inside of all ellipsoids, (h, 4, 4); None: there is none.

    Ellipsoids that the solution touches are equations, the others are left out: an active set, which the
    signs of the multipliers confirm.
    """
    goal, count, size = space.onto @ wanted, len(space.basis), len(space.heavy)
    active = np.zeros(size, bool)
    start, pressure = np.zeros(count), np.zeros(size)
    for _ in range(ROUNDS):
        touched = np.flatnonzero(active)
        bounds = np.zeros((len(touched), *space.basis.shape[1:]))
        bounds[np.arange(len(touched)), touched] = ellipsoids[touched]
        solved = _least_divergence(
            np.concatenate([space.basis, bounds]),
            np.append(goal, np.zeros(len(touched))),
            np.append(start, pressure[touched]),
            farthest * size,
        )
        if solved is None:
            return None
        found, multipliers = solved
        start, pressure = multipliers[:count], np.zeros(size)
        pressure[touched] = np.minimum(multipliers[count:], 0.0)
        outside = (ellipsoids * found).sum(axis=(1, 2)) < -1e-12
        now = (pressure < 0) | outside & ~active
        if (now == active).all():
            return found
        active = now
    return None


def _least_divergence(
    matrices: np.ndarray, goal: np.ndarray, start: np.ndarray, farthest: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Minimise tr X - log det X subject to <matrices, X> = goal by Newton's method on the dual problem.

    X = (1 + sum of l_k V_k)^-1 for multipliers l, which are the unknowns: as many as there are equations.

    Args:
        matrices: V, (k, h, 4, 4), symmetric. goal: (k,).
        start: multipliers to begin with, (k,); zeros if they are of no use.
        farthest: divergence from which on the search ends: without a solution the dual has no maximum.

    Returns:
        X, (h, 4, 4), and l, (k,); None: there is no positive definite X, or it is farther away.
    """
    flat = matrices.reshape(len(matrices), -1)
    multipliers = start
    found, cost = _primal(matrices, multipliers, goal)
    if not np.isfinite(cost):
        multipliers = np.zeros(len(goal))
        found, cost = _primal(matrices, multipliers, goal)
    accepted = CONVERGED * max(1.0, float(np.abs(goal).max()))
    before = np.inf
    for _ in range(STEPS):
        lack = flat @ found.ravel() - goal
        away = float(np.abs(lack).max())
        if away <= accepted or (away < 1e3 * accepted and away >= before):
            return found, multipliers
        before = away
        curvature = (found @ matrices @ found).reshape(flat.shape) @ flat.T
        try:
            step = np.linalg.solve(curvature, lack)
        except np.linalg.LinAlgError:
            return None
        decrement = float(lack @ step)
        length = min(1.0, 0.9 * _longest(matrices, found, step))
        while length > SHORTEST:
            now, change = _primal(matrices, multipliers + length * step, goal)
            # Near the end, rounding hides the descent.
            if np.isfinite(change) and (decrement < 1e-8 or change <= cost - 0.1 * length * decrement):
                break
            length /= 2
        else:
            return None
        multipliers, found, cost = multipliers + length * step, now, change
        if -cost > farthest:  # the dual is a lower bound of the divergence
            return None
    return None


def _longest(matrices: np.ndarray, found: np.ndarray, step: np.ndarray) -> float:
    """Return how many times a step of the multipliers can be made while X stays positive definite."""
    root = np.linalg.cholesky(found)
    least = np.linalg.eigvalsh(root.mT @ np.tensordot(step, matrices, axes=1) @ root).min()
    return -1 / least if least < 0 else np.inf


def _primal(matrices: np.ndarray, multipliers: np.ndarray, goal: np.ndarray) -> tuple[np.ndarray, float]:
    """Return X and the negative of the dual; infinite where X is not positive definite."""
    inverse = np.eye(4) + np.tensordot(multipliers, matrices, axes=1)
    size = np.linalg.eigvalsh(inverse)
    if size.min() <= 0:
        return inverse, np.inf
    found = np.linalg.inv(inverse)
    return (found + found.mT) / 2, float(multipliers @ goal - np.log(size).sum())


def _nearest_value(space: _Space, ellipsoids: np.ndarray, target: Target) -> tuple[np.ndarray, float]:
    """Return the base parameters of a consistent robot nearest to the estimate, (p,) [m], and the misfit.

    It is a semidefinite program: least squares subject to X - LEAST positive semidefinite, the ellipsoids and
    the total mass.
    """
    import cvxpy as cp  # takes a second to load, and few estimates need it

    links = [cp.Variable((4, 4), symmetric=True) for _ in space.heavy]
    stacked = cp.hstack([cp.vec(one, order="C") for one in links])
    sums = space.rows.reshape(len(space.rows), -1) @ stacked
    deviation = np.sqrt(np.diag(target.covariance))
    root = np.linalg.cholesky(target.covariance / np.outer(deviation, deviation))
    whiten = np.linalg.inv(root) / deviation
    away = whiten @ (sums[:-1] / target.mass - target.value)
    inside = [one >> LEAST * np.eye(4) for one in links]
    inside += [cp.sum(cp.multiply(bound, one)) >= 0 for bound, one in zip(ellipsoids, links, strict=True)]
    problem = cp.Problem(cp.Minimize(cp.norm(away)), [*inside, sums[-1] / target.mass == 1.0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of an inaccurate optimum: what is used of it is made exact below
        problem.solve(solver=cp.CLARABEL)
    if problem.status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise InputError(f"{FAR}, and the search for the nearest ones ended as {problem.status}")
    value = np.asarray(sums.value[:-1]) / target.mass
    return value, float(np.linalg.norm(whiten @ (value - target.value)))

"""Solve for static equilibria: Newton's method once a posture, a chord method for all its runs."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.measurements.cells import CELLS, CORNERS
from tulip_testbed.sim.statics.forces import Load, StaticState, board_wrench, residual
from tulip_testbed.sim.statics.mechanism import Mechanism
from tulip_testbed.sim.statics.slope import closed_slope, has_closed_slope

STEP = 1e-6  # rad or m, of finite differences
NEWTON_STEPS = 25
NEAR_STEPS = 8  # of Newton's method from equilibria of a similar mechanism
CHORD_STEPS = 10
FREE_PLAY = (0.0, 0.25, 0.5, 0.75)
TOGETHER = 1000  # states in one evaluation, so that they fit the processor's cache
LARGEST_STEP = 0.1  # rad or m, of Newton's method
TOLERANCE = 1e-9  # rad or m, of the last change
LARGEST_CONDITION = 1e12  # beyond it a derivative counts as singular


@dataclass(frozen=True)
class Reference:
    """Solved postures, about which the chord method solves others.

    Attributes:
        state: equilibria, batch (k,).
        inverse: inverse of the residual's derivative there, (k, s, s), s = 6 + n + 12.
        slope: that derivative, (k, s, s).
        solved: whether Newton's method converged, (k,) bool.
    """

    state: StaticState
    inverse: np.ndarray
    slope: np.ndarray
    solved: np.ndarray


def solve_by_newton(mechanism: Mechanism, start: StaticState, load: Load) -> Reference:
    """Solve for equilibria by Newton's method from nearby states, each on its own.

    Free play is opened in steps, since its torque has a kink at which the derivative jumps. So has a motor at
    its torque limit; if a start exceeds a limit, it is first solved without torque limits. So has a board
    that rocks; it is first solved balanced, beyond which it rests on the side where the load is then.
    """
    asked = np.abs(mechanism.gain * (load.command - start.angles[..., mechanism.motors]))
    if len(over := np.flatnonzero((asked > mechanism.limit).any(axis=-1))):
        start, unlimited = start.take(np.arange(len(asked))), np.full_like(mechanism.limit, np.inf)
        free = replace(mechanism, limit=unlimited)
        start.put(over, _newton(free, start.take(over), load.take(over)).state)
    if any(mechanism.rocking):
        start = _newton(mechanism.balanced, start, load).state
    for part in FREE_PLAY if any(low < high for _, (low, high), _ in mechanism.springs) else ():
        start = _newton(mechanism.with_play(part), start, load).state
    return _newton(mechanism, start, load)


def solve_near(mechanism: Mechanism, near: Reference, start: StaticState, load: Load) -> Reference:
    """Solve for equilibria that lie near those of a similar mechanism.

    Where a spring has free play or a board rocks there may be several equilibria: then, and for postures that
    Newton's method does not solve from there, the way is that of `solve_by_newton`.

    Args:
        near: equilibria of the similar mechanism, batch (k,).
        start: where the search begins otherwise.
    """
    alike = near.state.angles.shape == start.angles.shape
    kinked = any(mechanism.rocking) or any(low < high for _, (low, high), _ in mechanism.springs)
    if not alike or kinked:
        return solve_by_newton(mechanism, start, load)
    n, slope_of = start.angles.shape[-1], _slope_of(mechanism)
    state, slope = near.state.take(np.arange(len(start.position))), near.slope.copy()
    solved, left = np.zeros(len(start.position), bool), np.flatnonzero(near.solved)
    for _ in range(NEAR_STEPS):
        part, loads = state.take(left), load.take(left)
        slope[left] = slope_of(mechanism, part, loads)
        try:  # without the inverses, which take longer
            change = -np.linalg.solve(slope[left], residual(mechanism, part, loads)[..., None])[..., 0]
        except np.linalg.LinAlgError:
            break
        state.put(left, part.moved(change))
        moves = np.abs(change[..., : 6 + n]).max(axis=-1)
        solved[left] = moves < TOLERANCE
        if not len(left := left[(moves >= TOLERANCE) & (moves < LARGEST_STEP)]):
            break
    inverse = inverted(slope)
    if len(rest := np.flatnonzero(~solved)):
        found = solve_by_newton(mechanism, start.take(rest), load.take(rest))
        state.put(rest, found.state)
        slope[rest], inverse[rest], solved[rest] = found.slope, found.inverse, found.solved
    return Reference(state, inverse, slope, solved)


def _slope_of(mechanism: Mechanism) -> Callable[[Mechanism, StaticState, Load], np.ndarray]:
    return closed_slope if has_closed_slope(mechanism) else derivative


def _newton(mechanism: Mechanism, start: StaticState, load: Load) -> Reference:
    count, n = start.position.shape[0], start.angles.shape[-1]
    state = start.take(np.arange(count))
    slope = np.zeros((count, 18 + n, 18 + n))
    inverse, left, slope_of = slope.copy(), np.arange(count), _slope_of(mechanism)
    for _ in range(NEWTON_STEPS):
        part, loads = state.take(left), load.take(left)
        slope[left] = slope_of(mechanism, part, loads)
        inverse[left] = inverted(slope[left])
        change = -(inverse[left] @ residual(mechanism, part, loads)[..., None])[..., 0]
        moves = np.abs(change[..., : 6 + n]).max(axis=-1)
        # Converged items stay unchanged, so that no item depends on the others.
        step = np.minimum(1.0, LARGEST_STEP / np.maximum(moves, TOLERANCE))
        state.put(left, part.moved(step[:, None] * change))
        if not len(left := left[moves >= TOLERANCE]):
            break
    return Reference(state, inverse, slope, ~np.isin(np.arange(count), left))


def inverted(slope: np.ndarray) -> np.ndarray:
    """Invert derivatives, (b, s, s); pseudo-inverses of those that are singular: no such posture is held."""
    try:
        inverse = np.linalg.inv(slope)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(slope)
    size = np.linalg.norm(slope, axis=(1, 2)) * np.linalg.norm(inverse, axis=(1, 2))
    if len(singular := np.flatnonzero(~(size < LARGEST_CONDITION))):
        inverse[singular] = np.linalg.pinv(slope[singular])
    return inverse


def derivative(mechanism: Mechanism, state: StaticState, load: Load) -> np.ndarray:
    """Compute the derivative of the residual by a flat batch's change, by central differences, (b, s, s)."""
    count, n = state.angles.shape
    size = np.repeat([STEP, 1.0], [6 + n, 12])  # linear in the wrenches
    steps = np.diag(size)[:, None]
    together = max(1, TOGETHER // max(count, 1))
    columns = []
    for first in range(0, len(steps), together):
        some = steps[first : first + together]
        ahead, behind = (residual(mechanism, state.moved(sign * some), load) for sign in (1, -1))
        columns.append((ahead - behind) / (2 * size[first : first + together, None, None]))
    return np.moveaxis(np.concatenate(columns), 0, -1)


def solve_by_chord(
    mechanism: Mechanism, reference: Reference, which: np.ndarray, load: Load
) -> tuple[StaticState, np.ndarray]:
    """Solve for equilibria near solved ones with the derivative of those (chord method).

    It converges linearly, the faster the nearer; items that do not converge are solved by Newton's method.

    Args:
        which: index of the reference posture of every batch item, (b,).
        load: loads of every item.

    Returns:
        The states, batch (b,), and whether each has converged, (b,) bool.
    """
    state, solved = _chord(mechanism, reference, which, load)
    if len(left := np.flatnonzero(~solved)):
        # The derivative differs where a torque limit or a joint's stop becomes active.
        last = solve_by_newton(mechanism, reference.state.take(which[left]), load.take(left))
        state.put(left, last.state)
        solved[left] = last.solved
    return state, solved


def _chord(
    mechanism: Mechanism, reference: Reference, which: np.ndarray, load: Load
) -> tuple[StaticState, np.ndarray]:
    n = reference.state.angles.shape[-1]
    state = reference.state.take(which)
    solved, left = np.zeros(len(which), bool), np.arange(len(which))
    for _ in range(CHORD_STEPS):
        part, loads = state.take(left), load.take(left)
        inverse = reference.inverse
        if not np.array_equal(which[left], np.arange(len(inverse))):  # or else no large array is copied
            inverse = inverse[which[left]]
        with np.errstate(over="ignore", invalid="ignore"):  # diverging items are not solved here
            change = -(inverse @ residual(mechanism, part, loads)[..., None])[..., 0]
            state.put(left, part.moved(change))
        solved[left] = np.abs(change[..., : 6 + n]).max(axis=-1) <= TOLERANCE
        if not len(left := np.flatnonzero(~solved)):
            break
    return state, solved


LEAST_LOAD = 1e-6  # N


def cell_forces(mechanism: Mechanism, state: StaticState, load: Load) -> np.ndarray:
    """Return the tared forces of the eight cells, (..., 8) [N].

    A rigid board on four equal springs has the smallest forces that balance its load; a cell that would have
    to pull reads zero and the other three carry the board. So do three cells of a board that rocks.
    """
    sides = []
    for side, own in enumerate(mechanism.plate_weight):
        wrench, foot = state.wrench[..., side, :], load.feet[..., side, :]
        down, tip = board_wrench(mechanism, wrench, foot, load.plates[..., side, :])
        balance = np.vstack([np.ones(4), mechanism.cells[side].T])
        loads = np.stack([down, tip[..., 1], -tip[..., 0]], axis=-1)
        forces = own + loads @ np.linalg.pinv(balance).T
        if (rocking := mechanism.rocking[side]) is not None:
            sides.append(rocking.shared(forces))
            continue
        lack, twist = np.maximum(-forces, 0.0), np.linalg.svd(balance)[2][-1]
        worst = lack.argmax(axis=-1)[..., None]
        forces = forces + np.take_along_axis(lack, worst, -1) / twist[worst] * twist
        sides.append(forces)
    return np.concatenate(sides, axis=-1) - mechanism.tare


def faults(
    mechanism: Mechanism, state: StaticState, load: Load, cells: np.ndarray, feet: tuple[str, str]
) -> np.ndarray:
    """Return why each posture would not stand as planned, or "", (...,) of text.

    A sole is flat while its centre of pressure is inside its corners, a board while at most one cell would
    have to pull, and a foot does not slide while force and torsion are inside the limit surface (as in
    `sim.dynamics.stiction`).

    Args:
        cells: tared cell forces, (..., 8) [N].
    """
    m, reason = mechanism, np.full(cells.shape[:-1], "", dtype=object)
    for side, foot in enumerate(feet):
        force, moment = state.wrench[..., side, :3], state.wrench[..., side, 3:]
        press = np.maximum(force[..., 2], LEAST_LOAD)
        center = np.stack([-moment[..., 1], moment[..., 0]], axis=-1) / press[..., None]
        yaw = load.feet[..., side, 2]
        c, s = np.cos(yaw), np.sin(yaw)  # from the world's axes to the sole's
        x, y = center[..., 0], center[..., 1]
        center = np.stack([c * x + s * y, c * y - s * x], axis=-1)
        arms = np.sqrt(((m.corners[side] - center[..., None, :]) ** 2).sum(axis=-1))
        low, high = m.corners[side].min(axis=0), m.corners[side].max(axis=0)
        lost = ((center < low) | (center > high)).any(axis=-1) | (force[..., 2] <= LEAST_LOAD)
        lost &= load.foot_contact[..., side]
        names = np.array([f"lost sole corner {foot}_{corner}" for corner in CORNERS], dtype=object)
        reason = np.where(lost & (reason == ""), names[arms.argmax(axis=-1)], reason)
        twist = moment[..., 2] - x * force[..., 1] + y * force[..., 0]
        carried = m.sole_friction[side] * press
        along = (force[..., :2] ** 2).sum(axis=-1) / carried**2
        slides = load.foot_contact[..., side] & (along + (twist / (carried * arms.mean(axis=-1))) ** 2 > 1)
        reason = np.where(slides & (reason == ""), f"slipped {foot}", reason)
    pulled = cells + m.tare < -LEAST_LOAD
    lifted = np.array([f"lifted cell {cell}" for cell in CELLS], dtype=object)[pulled.argmax(axis=-1)]
    return np.where(pulled.any(axis=-1) & (reason == ""), lifted, reason)

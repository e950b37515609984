"""Preflight: cells that are read in each other's place, turned on a plate, or with a wrong sign or unit."""

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tulip_testbed.identification.center_of_pressure import cell_positions, center_of_pressure, loads
from tulip_testbed.identification.noise_structure import Groups, groups
from tulip_testbed.identification.preflight.agreement import SCATTERS, AgreementFit
from tulip_testbed.identification.preflight.finding import Finding, row_name, skipped
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES

NAME = "wiring of cells"
# Chi-square that another wiring has to save, in units of what is then left for a degree of freedom. Of other
# effects five times as large as usual, cross-talk of cells and soft soles save up to 80 (development seeds).
DECISIVE = 100.0
LEAST_DOF = 20  # with fewer, one of some seventy wirings may fit faulty readings by chance
ROUNDING = 1e-9  # of a chi-square: less of it cannot be told from what the model explains
# Of the scatter, by cells that are connected otherwise in some rows; effects at one placement or of the soles
# that are eight times as large as plausible leave 0.7 (development seeds).
MOST_LEFT = 0.5
MOST_STARTS = 10  # rows of a placement since which this may be so,
MOST_LIKELY = 8  # for so many wirings
MISREAD = {"has the wrong sign": -1.0, "is read in kilograms": 9.81, "is read in pounds": 4.448}
TURNED = {  # corners of a plate that are read in place of each, in the order of `CORNERS`
    "turned by 90 degrees": (1, 2, 3, 0),
    "turned by 180 degrees": (2, 3, 0, 1),
    "turned by 270 degrees": (3, 0, 1, 2),
    "mirrored, left for right": (1, 0, 3, 2),
    "mirrored, front for rear": (3, 2, 1, 0),
}


class _Wiring(NamedTuple):
    """Cells that may be connected otherwise.

    Attributes:
        words: what is wrong then. cells: which is read in place of each, (8,). factor: of each, (8,).
        is_effect: whether an effect of the catalogue says so.
    """

    words: str
    cells: np.ndarray
    factor: np.ndarray
    is_effect: bool = False


def wiring(measurements: Measurements, found: AgreementFit) -> Finding:
    """Compare the fit with that of cells that are connected otherwise, in all rows or in some.

    A wrong wiring moves the centre of pressure by centimetres: no other fault is repaired by one.
    """
    if found.dof < LEAST_DOF:
        return skipped(NAME, f"{found.dof} degrees of freedom, fewer than {LEAST_DOF}")
    force, positions, wirings = loads(measurements), cell_positions(measurements), [*_wirings()]
    stated, placement, changes = center_of_pressure(measurements), groups(measurements.placement), []
    for one in wirings:
        read = force[:, one.cells] * one.factor
        total = read.sum(axis=1, keepdims=True)
        center = np.einsum("mc,mca->ma", read, positions) / np.where(total > 0, total, np.nan)
        changes.append(center - stated)
    first = np.unique(placement.number, return_index=True)[1][placement.number]
    late = np.arange(len(first))[:, None] >= first[:, None] + np.arange(MOST_STARTS)
    likely = np.argsort([_squares(found, change, placement, late[:, :1]).min() for change in changes])
    squares = {int(k): _squares(found, changes[k], placement, late) for k in likely[:MOST_LIKELY]}
    best, square = min(squares.items(), key=lambda each: each[1].min())
    at, way = np.unravel_index(square.argmin(), square.shape)
    before, after = np.sqrt(np.array([found.square, square[at, way]]) / found.dof)
    wrong = bool((found.square - square[at, way]) / max(1.0, after**2) > DECISIVE and after < SCATTERS)
    if some := bool(at or way):
        wrong = wrong and after < MOST_LEFT * before
    row = int(np.flatnonzero(placement.number == at)[0])
    if way < MOST_STARTS:
        when = f" since {row_name(measurements, row + int(way))}"
    else:
        when = f" {'until' if way == MOST_STARTS else 'in'} placement {measurements.placement[row]}"
    words = wirings[best].words + (when if some else "")
    scatter = f"scatter {before:.3g} times what is stated"
    return Finding(
        NAME,
        "fail" if wrong else "pass",
        f"{words}: {scatter}, {after:.3g} times if that is undone"
        if wrong
        else f"{scatter}; no other wiring explains it",
        "the wiring that is stated",
        words if wrong else "",
        "Look at plugs, channels and signs of these cells; correct their columns, or leave these rows out.",
        gross=wrong and (some or not wirings[best].is_effect),
    )


def _wirings() -> Iterator[_Wiring]:
    cells, plain = np.arange(len(CELLS)), np.ones(len(CELLS))
    for a, b in itertools.combinations(cells.tolist(), 2):
        order = cells.copy()
        order[[a, b]] = b, a
        words = f"cell.{CELLS[a]} and cell.{CELLS[b]} are read in each other's place"
        yield _Wiring(words, order, plain, is_effect=a // len(CORNERS) == b // len(CORNERS))
    for words, factor in MISREAD.items():
        for k, name in enumerate(CELLS):
            yield _Wiring(f"cell.{name} {words}", cells, np.where(cells == k, factor, 1.0))
    for p, plate in enumerate(PLATES):
        mine = cells // len(CORNERS) == p
        for words, corners in TURNED.items():
            order = cells.copy()
            order[mine] = cells[mine][list(corners)]
            yield _Wiring(f"the {plate} plate's cells are {words}", order, plain)
    words = f"the {PLATES[0]} plate's cells are read in place of the {PLATES[1]} plate's"
    yield _Wiring(words, np.roll(cells, len(CORNERS)), plain)


def _squares(found: AgreementFit, change: np.ndarray, placement: Groups, late: np.ndarray) -> np.ndarray:
    """Return the chi-square of the best fitting model if the residuals of some rows change by (m, 2).

    Args:
        late: rows since the first of their placement, since the second and so on, (m, s) bool.

    Returns:
        Of the rows since each of these, of those until the placement's end, and of its own, (g, s + 2);
        infinite where a change is not finite or there is no such row, and where all rows are meant, which
        the first says.
    """
    finite = np.isfinite(change.sum(axis=1, keepdims=True))
    column = np.where(finite, change, 0.0)[..., None] * late[:, None]
    score = found.score[..., None] + 0.5 * found.weights(column)  # of the square's change
    across, along, bad = (
        _spans(placement.sums(part))
        for part in (column.mT @ found.weighted, (column * score).sum(axis=1), 1.0 * (late & ~finite))
    )
    own = found.square + 2 * along
    left = np.maximum(own - ((across @ found.covariance) * across).sum(axis=2), ROUNDING * own)
    left[:, :-2][placement.sums(1.0 * late) == 0] = np.inf
    left[-1, -2] = np.inf
    if len(left) == 1:
        left[0, -1] = np.inf
    return np.where(bad > 0, np.inf, left)


def _spans(part: np.ndarray) -> np.ndarray:
    """Sum over rows since, until and in each placement, from the sums of its late rows, (g, s, ...)."""
    until = np.cumsum(part[:, :1], axis=0)
    return np.concatenate([part + until[-1:] - until, until, part[:, :1]], axis=1)

"""Preflight: cells that are read in each other's place, turned on a plate, or with a wrong sign or unit."""

import itertools
from typing import NamedTuple

import numpy as np

from tulip_testbed.identification.center_of_pressure import cell_positions, center_of_pressure, loads
from tulip_testbed.identification.preflight.agreement import NO_CELL_SD, SCATTERS, AgreementFit
from tulip_testbed.identification.preflight.finding import Finding, skipped
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES

NAME = "wiring of cells"
# Chi-square that another wiring has to save, in units of what is then left for a degree of freedom. Of other
# effects five times as large as usual, cross-talk of cells and soft soles save up to 80 (development seeds).
DECISIVE = 100.0
LEAST_DOF = 20  # with fewer, one of some seventy wirings may fit faulty readings by chance
ROUNDING = 1e-9  # of a chi-square: less of it cannot be told from what the model explains
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


def wiring(measurements: Measurements, found: AgreementFit | None) -> Finding:
    """Compare the fit with that of cells that are connected otherwise.

    A wrong wiring moves the centre of pressure by centimetres: no other fault is repaired by one.
    """
    if found is None:
        return skipped(NAME, NO_CELL_SD)
    if found.dof < LEAST_DOF:
        return skipped(NAME, f"{found.dof} degrees of freedom, fewer than {LEAST_DOF}")
    force, positions, wirings = loads(measurements), cell_positions(measurements), _wirings()
    stated, columns = center_of_pressure(measurements), []
    for one in wirings:
        read = force[:, one.cells] * one.factor
        total = read.sum(axis=1, keepdims=True)
        center = np.einsum("mc,mca->ma", read, positions) / np.where(total > 0, total, np.nan)
        columns.append(found.residual + center - stated)
    square = _squares(found, np.nan_to_num(np.stack(columns, axis=2), nan=np.inf))
    best = int(square.argmin())
    before, after = np.sqrt(np.array([found.square, square[best]]) / found.dof)
    saved = (found.square - square[best]) / max(1.0, after**2)
    wrong = saved > DECISIVE and after < SCATTERS
    words, *_, is_effect = wirings[best]
    scatter = f"scatter {before:.3g} times what is stated"
    return Finding(
        NAME,
        "fail" if wrong else "pass",
        f"{words}: {scatter}, {after:.3g} times if that is undone"
        if wrong
        else f"{scatter}; no other wiring explains it",
        "the wiring that is stated",
        words if wrong else "",
        "Look at plugs, channels and signs of these cells, and correct their columns.",
        gross=wrong and not is_effect,
    )


def _wirings() -> list[_Wiring]:
    """Return the wirings other than the stated one."""
    cells, plain = np.arange(len(CELLS)), np.ones(len(CELLS))
    out = []
    for a, b in itertools.combinations(cells.tolist(), 2):
        order = cells.copy()
        order[[a, b]] = b, a
        words = f"cell.{CELLS[a]} and cell.{CELLS[b]} are read in each other's place"
        out.append(_Wiring(words, order, plain, is_effect=a // len(CORNERS) == b // len(CORNERS)))
    for words, factor in MISREAD.items():
        for k, name in enumerate(CELLS):
            out.append(_Wiring(f"cell.{name} {words}", cells, np.where(cells == k, factor, 1.0)))
    for p, plate in enumerate(PLATES):
        mine = cells // len(CORNERS) == p
        for words, corners in TURNED.items():
            order = cells.copy()
            order[mine] = cells[mine][list(corners)]
            out.append(_Wiring(f"the {plate} plate's cells are {words}", order, plain))
    words = f"the {PLATES[0]} plate's cells are read in place of the {PLATES[1]} plate's"
    return [*out, _Wiring(words, np.roll(cells, len(CORNERS)), plain)]


def _squares(found: AgreementFit, residuals: np.ndarray) -> np.ndarray:
    """Return the chi-square of each column of residuals, (m, 2, n), in the best fitting model, (n,)."""
    possible = np.isfinite(residuals).all(axis=(0, 1))
    columns = residuals[..., possible]
    across = np.tensordot(found.weighted, columns, axes=((0, 1), (0, 1)))
    out = np.full(residuals.shape[2], np.inf)
    square = (columns * found.weights(columns)).sum(axis=(0, 1))
    left = square - (across * (found.covariance @ across)).sum(axis=0)
    out[possible] = np.maximum(left, ROUNDING * square)
    return out

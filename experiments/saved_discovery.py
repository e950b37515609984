"""Read a discovery's folder again, and its residuals as curves over the experiment."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from tulip_testbed.experiments.discovery_folder import PARTS
from tulip_testbed.experiments.montecarlo.montecarlo_folder import RUN_FILE
from tulip_testbed.experiments.saved_run import Hashed, check_outputs, check_robot, parsed
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import ANCHORED, SIZE
from tulip_testbed.identification.residual_noise import Noise, whitening
from tulip_testbed.sim.errors import InputError, shortened, validation_message
from tulip_testbed.sim.files import read_bytes
from tulip_testbed.sim.measurements import Measurements, read_measurements
from tulip_testbed.sim.measurements.table_files import read_json
from tulip_testbed.sim.robot import Robot

NEEDED = ("discovery.json", "residuals.csv", "story.txt", "measurements/manifest.json")
DIFF = "rig/diff.txt"
# What each part is called, its unit, how many of it go on one SI unit, its channel.
SHOWN = (
    ("centre of pressure, x", "mm", 1e3, "A"),
    ("centre of pressure, y", "mm", 1e3, "A"),
    ("sum of the cells", "N", 1.0, "F"),
    ("twist, right plate", "N", 1.0, "T"),
    ("twist, left plate", "N", 1.0, "T"),
    ("swing foot's height", "mm", 1e3, "C"),
    ("swing foot's roll", "mrad", 1e3, "C"),
    ("swing foot's pitch", "mrad", 1e3, "C"),
    ("swing foot's x", "mm", 1e3, "C"),
    ("swing foot's y", "mm", 1e3, "C"),
    ("swing foot's yaw", "mrad", 1e3, "C"),
)


class Source(BaseModel):
    measurements: str
    robot: str


class DiscoveryFile(Hashed):
    """run.json of a discovery."""

    configuration: Source


class Stated(BaseModel):
    encoder_sd: float
    cell_sd: float
    placement_sd: Annotated[list[float], Field(min_length=6, max_length=6)]
    not_as_stated: list[str]


class Ratio(BaseModel):
    before: float
    after: float | None
    floor: float


class Size(BaseModel):
    name: str
    value: float
    unit: str
    low95: float | None
    high95: float | None


class Candidate(BaseModel):
    gap: int
    name: str
    target: str | None
    parameters: list[Size]
    log_bayes_factor: float


class Moved(BaseModel):
    number: int
    name: str
    before_mm: float
    after_mm: float
    standard_error_mm: float
    moved_in_standard_errors: float


class Proposed(BaseModel):
    do: str
    separation_gain: float


class Hidden(BaseModel):
    name: str
    target: str | None
    parameter: int | None
    bias_mm_per_prior_sd: float | None


class Left(BaseModel):
    channel: str
    pattern: str
    p: float


class Repeats(BaseModel):
    pairs: int
    chi_square_per_freedom: dict[str, float]
    p: dict[str, float]


class Check(BaseModel):
    postures: int
    tried: int
    left_over_noise: float | None
    reason: str | None


class Document(BaseModel):
    """What a page needs of discovery.json."""

    verdict: Literal["named", "ambiguous", "unknown", "none"]
    story: Annotated[list[str], Field(min_length=1)]
    candidates: list[Candidate]
    gap: dict[Literal["A", "F", "T", "C", "all", "heldout_rms_mm"], Ratio | None]
    parameters: list[Moved]
    next_experiment: list[Proposed]
    undetectable: list[Hidden]
    left: list[Left]
    repeats: Repeats
    noise: Stated
    check: Check | None
    wall_s: float


@dataclass(frozen=True)
class SavedDiscovery:
    """A discovery as its folder holds it.

    Attributes:
        document: run.json. report: discovery.json.
        before, after: residuals of every posture as measured and freed of what was found, (m, 11), as
            `discovery.channels` has them.
        diff: what the adopted rig changes, for a person; "": nothing was adopted.
    """

    folder: Path
    document: dict[str, Any]
    report: dict[str, Any]
    measurements: Measurements
    before: np.ndarray
    after: np.ndarray
    diff: str
    robot: Robot


@dataclass(frozen=True)
class Curve:
    """One residual over the experiment, in the unit that it is shown in.

    Attributes:
        channel: "A", "F", "T" or "C". before, after, sd: (m,); nan where the posture does not have it.
    """

    channel: str
    name: str
    unit: str
    before: np.ndarray
    after: np.ndarray
    sd: np.ndarray


def read_discovery(folder: Path, robot: Robot) -> SavedDiscovery:
    """Read a discovery and check that nothing in it was changed.

    Raises:
        InputError: another kind or version of run, another robot's, or a file that is not what was written.
    """
    folder = Path(folder)
    document = read_json(folder / RUN_FILE)
    outputs = parsed(DiscoveryFile, folder, document).outputs
    check_robot(folder, document["inputs"], robot)
    check_outputs(folder, outputs, NEEDED)
    report = read_json(folder / "discovery.json")
    try:
        Document.model_validate(report)
    except ValidationError as error:
        raise InputError(f"{folder / 'discovery.json'}: {validation_message(error)}") from None
    rows = _table(folder / "residuals.csv")
    measurements = read_measurements(folder / "measurements")
    wanted = {side: [f"{side}.{part}" for part in PARTS] for side in ("before", "after")}
    columns = rows.dtype.names or ()
    for name in (*wanted["before"], *wanted["after"]):
        if name not in columns:
            raise InputError(f"{folder / 'residuals.csv'}: found no column {name}")
    if len(rows) != len(measurements):
        raise InputError(
            f"{folder / 'residuals.csv'}: found {len(rows)} rows, expected {len(measurements)}, as many as "
            "the measurements have"
        )
    before, after = (np.column_stack([rows[name] for name in wanted[side]]) for side in wanted)
    diff = read_bytes(folder / DIFF).decode(errors="replace") if DIFF in outputs else ""
    return SavedDiscovery(folder, document, report, measurements, before, after, diff, robot)


def _table(path: Path) -> np.ndarray:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of an empty file numpy only warns
            return np.atleast_1d(np.genfromtxt(path, delimiter=",", names=True, deletechars=""))
    except (ValueError, UserWarning) as error:
        raise InputError(f"{path}: found no table of numbers ({shortened(str(error))})") from None


def residual_curves(run: SavedDiscovery) -> list[Curve]:
    """All residuals in the order of time, with the s.d. that the noise gives them.

    The swing foot's x, y and yaw are known up to a constant of the stance, hence about its mean.
    """
    observed = observe(run.measurements, nominal_robot(run.robot, common_support(run.measurements.support)))
    sd = _spread(run, observed)
    before, after = (_about_stances(side, observed.stance) for side in (run.before, run.after))
    order = time_order(run)
    return [
        Curve(channel, name, unit, *(scale * side[order, j] for side in (before, after, sd)))
        for j, (name, unit, scale, channel) in enumerate(SHOWN)
    ]


def time_order(run: SavedDiscovery) -> np.ndarray:
    """Rows of the measurements in the order in which they were measured, (m,)."""
    return np.argsort(run.measurements.time, kind="stable")


def _spread(run: SavedDiscovery, observed: Observation) -> np.ndarray:
    """Standard deviation of every residual by the noise that the discovery took, (m, 11)."""
    stated = run.report["noise"]
    noise = Noise(stated["encoder_sd"], stated["cell_sd"], np.array(stated["placement_sd"]), ())
    white = whitening(observed, observed.nominal.value, noise)
    n = len(observed.tree.joints)
    levers = white.sensitivity[..., n + 8 : n + 14] * noise.plates
    variance = np.diagonal(white.own, axis1=1, axis2=2) + (levers**2).sum(axis=2)
    missing = np.ones(variance.size, bool)
    missing[white.rows] = False
    return np.sqrt(np.where(missing.reshape(-1, SIZE), np.nan, variance))


def _about_stances(residual: np.ndarray, stance: np.ndarray) -> np.ndarray:
    out = residual.copy()
    for rows in _groups(stance):
        out[rows, ANCHORED] -= out[rows, ANCHORED].mean(axis=0)
    return out


def _groups(numbers: np.ndarray) -> Iterator[np.ndarray]:
    for number in np.unique(numbers):
        yield np.flatnonzero(numbers == number)

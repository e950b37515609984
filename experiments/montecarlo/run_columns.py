"""The record of a run: one row of the results."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import present, read_bytes, write_bytes
from tulip_testbed.base.table_files import Columns
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.laboratory_runs import OrdinaryOutcome, Source, stream_of
from tulip_testbed.identification.base_parameters import BaseParameters, simplified_numbers
from tulip_testbed.identification.estimators import Estimate
from tulip_testbed.identification.statistics import standard_errors
from tulip_testbed.sim.outcome import Outcome
from tulip_testbed.sim.robot import Robot

TEXT, COUNTS = "failure", ("run", "rows", "dropped")  # columns of texts and of whole numbers
SCALARS = ("chi_square", "residual_dof")
# Of a parameter: the estimate and its s.e.; both if imperfections that the data do not show were known.
QUANTITIES = ("value", "se", "dof", "given", "given_se")
EXACT: Mapping[str, float] = {}
MOST = 1e12  # of any number of a run: larger ones lose their last digits when they are squared


@dataclass(frozen=True)
class RunChunks:
    """The runs 0 to `runs` - 1 in files of `size` runs.

    The files together are one table, in order; most readers of Parquet take the folder's name for it.
    """

    folder: Path
    runs: int
    size: int

    def __len__(self) -> int:
        return -(-self.runs // self.size)

    def runs_of(self, index: int) -> range:
        return range(index * self.size, min((index + 1) * self.size, self.runs))

    def path(self, index: int) -> Path:
        return self.folder / f"chunk-{index:06d}.parquet"

    def missing(self) -> list[int]:
        return [index for index in range(len(self)) if not present(self.path(index))]

    def done(self) -> int:
        return self.runs - sum(len(self.runs_of(index)) for index in self.missing())

    def write(self, columns: Columns) -> int:
        """Write the chunk that begins with the first of these runs; returns how many runs it holds."""
        index, runs = int(columns["run"][0]) // self.size, columns["run"].tolist()
        assert runs == list(self.runs_of(index)), f"chunk {index} holds runs {runs}"
        sink = pa.BufferOutputStream()
        pa.parquet.write_table(pa.table(columns), sink, use_dictionary=False, write_statistics=False)
        write_bytes(self.path(index), sink.getvalue().to_pybytes())
        return len(runs)

    def read(self, index: int, names: Sequence[str]) -> Columns:
        """Return the columns of a chunk that every record has, and some more columns of numbers."""
        path, runs = self.path(index), self.runs_of(index)
        kinds = dict.fromkeys(COUNTS, pa.int64()) | dict.fromkeys(names, pa.float64()) | {TEXT: pa.string()}
        try:
            table = pa.parquet.read_table(pa.BufferReader(read_bytes(path)), columns=[*kinds])
            columns = {name: table.column(name) for name in kinds}
        except (OSError, ValueError, KeyError, pa.ArrowException) as error:
            raise InputError(f"{path}: cannot read ({' '.join(str(error).split())[:200]})") from None
        for name, column in columns.items():
            if column.type != kinds[name] or column.null_count:
                found = f"{shortened(column.type)}, {column.null_count} rows without any"
                raise InputError(
                    f"{path}: column '{name}': found {found}, expected {kinds[name]} in every row"
                )
        if not np.array_equal(columns["run"], runs):
            raise InputError(
                f"{path}: not the chunk of runs {runs[0]} to {runs[-1]}; remove it, and the same command "
                "makes it again"
            )
        return {name: column.to_numpy() for name, column in columns.items()}


@dataclass(frozen=True)
class Layout:
    """Columns of a record: all base parameters, numbered from 1, and the numbers that a model estimates."""

    names: tuple[str, ...]
    models: dict[str, tuple[int, ...]]

    @property
    def numbers(self) -> range:
        return range(1, len(self.names) + 1)

    def columns(self) -> list[str]:
        """Names of the columns that hold numbers; lengths in m, masses in kg."""
        names = [f"truth.{number}" for number in self.numbers]
        for model, numbers in self.models.items():
            names += [f"{model}.{what}.{n}" for what in QUANTITIES for n in numbers]
            names += [f"{model}.{scalar}" for scalar in SCALARS]
        return [*names, "mass", "mass_se", "mass_dof", "true_mass"]


def read_runs(chunks: RunChunks, layout: Layout) -> Columns:
    """Read all runs, those that could not be identified included."""
    parts = [chunks.read(index, layout.columns()) for index in range(len(chunks))]
    for index, part in enumerate(parts):
        _check_identified(chunks.path(index), identified(part))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def identified(runs: Columns) -> Columns:
    good = runs["failure"] == ""
    return {name: values[good] for name, values in runs.items()}


def matrix(runs: Columns, names: Sequence[str]) -> np.ndarray:
    """Return columns side by side, (runs, columns)."""
    return np.column_stack([runs[name] for name in names]).astype(float)


def errors_of(runs: Columns, model: str, numbers: Sequence[int], quantity: str = "value") -> np.ndarray:
    """Return the estimates minus the truth of a model's parameters, (runs, p) [m]; see `QUANTITIES`."""
    value, truth = ([f"{name}.{n}" for n in numbers] for name in (f"{model}.{quantity}", "truth"))
    return matrix(runs, value) - matrix(runs, truth)


def _check_identified(path: Path, columns: Columns) -> None:
    """Refuse what no run that could be identified gives; names the file, the column and the run."""
    for name, values in columns.items():
        if name in ("run", TEXT):
            continue
        fine = np.isnan(values) if name.endswith("chi_square") else np.zeros(len(values), bool)
        low, expected = -MOST, f"below {MOST:g} in size"
        if "dof" in name:
            low, expected = np.nextafter(0, 1), "above 0"
        elif ".se." in name or ".given_se." in name:
            low, expected = 0.0, f"from 0 to {MOST:g}"
        fine |= (values >= low) & ((values <= MOST) | ("dof" in name))
        if not fine.all():
            at = int(np.argmin(fine))
            found = f"column '{name}', run {columns['run'][at]}: found {values[at]:g}"
            raise InputError(f"{path}: {found}, expected a number {expected}")


def layout_of(robot: Robot, parameters: BaseParameters) -> Layout:
    """Return the columns for a robot; a robot without a simplified model has the full one alone."""
    models = {"full": tuple(range(1, len(parameters.names) + 1))}
    if "simplified" in robot.settings:
        models["simplified"] = tuple(simplified_numbers(robot, parameters))
    return Layout(parameters.names, models)


def run_job(
    source: Source, laboratory: Laboratory, parameters: BaseParameters, estimator: str, seed: int
) -> Callable[[Sequence[int]], Columns]:
    """Return the work of every run, as it is sent to the workers.

    It gives the columns of `Layout`, and run, rows, dropped (numbers), failure (text: why a run could not be
    identified, with NaN in its other columns, or "").

    Args:
        laboratory: its known effects are removed from the measurements.
        parameters: with the lengths of the robot that stands there.
    """
    robot, adopted = laboratory.robot, laboratory.known
    layout = layout_of(robot, parameters)

    def carried_out(runs: Sequence[int]) -> Columns:
        records = [record_of(outcome) for outcome in source([stream_of(seed, run) for run in runs])]
        columns: Columns = {"run": np.array(runs, dtype=np.int64)}
        for name in ("rows", "dropped", *layout.columns()):
            columns[name] = np.array([record[name] for record, _ in records])
        columns |= {name: columns[name].astype(np.int64) for name in ("rows", "dropped")}
        return columns | {"failure": np.array([failure for _, failure in records])}

    def record_of(outcome: Outcome | str) -> tuple[dict[str, float], str]:
        record = dict.fromkeys(layout.columns(), np.nan) | {"rows": 0, "dropped": 0}
        if isinstance(outcome, str):
            return record, outcome
        measured = outcome.measurements
        record |= {"rows": len(measured), "dropped": len(outcome.truth.dropped)}
        try:
            fit = identify(measured, robot, estimator=estimator, parameters=parameters, adopted=adopted)
        except InputError as error:
            return record, str(error)
        if isinstance(outcome, OrdinaryOutcome):
            truth, sizes = outcome.base, outcome.sizes
        else:
            truth, sizes = parameters.values(outcome.truth.standard), {}
        models = {"full": fit.full, "simplified": fit.simplified}
        mass = (*fit.mass, len(measured) - 1, outcome.truth.mass)
        return record | numbers_of(layout, models, truth, mass, sizes), ""

    return carried_out


def numbers_of(
    layout: Layout,
    models: Mapping[str, Estimate],
    truth: np.ndarray,
    mass: tuple[float, float, float, float],
    sizes: Mapping[str, float] = EXACT,
) -> dict[str, float]:
    """Return the columns of `Layout` of one run.

    Args:
        models: estimates by the model's name.
        truth: of all base parameters, (p,) [m].
        mass: the total mass, its standard error with its degrees of freedom, and the truth [kg].
        sizes: true sizes of the laboratory's imperfections, by name [SI].
    """
    record = {f"truth.{number}": float(truth[number - 1]) for number in layout.numbers}
    for model in layout.models:
        estimate = models[model]
        unseen, given, covariance = estimate.unseen, estimate.value, estimate.covariance
        if unseen is not None:
            given, covariance = unseen.given(given, sizes), unseen.covariance
        of_parameters = {
            "value": estimate.value,
            "se": standard_errors(estimate.covariance),
            "dof": estimate.interval_dof,
            "given": given,
            "given_se": standard_errors(covariance),
        }
        for what, values in of_parameters.items():
            record |= {f"{model}.{what}.{n}": float(v) for n, v in zip(estimate.numbers, values, strict=True)}
        scalars = chi_square(given - truth[estimate.numbers - 1], covariance), estimate.dof
        record |= {f"{model}.{name}": float(v) for name, v in zip(SCALARS, scalars, strict=True)}
    names = ("mass", "mass_se", "mass_dof", "true_mass")
    return record | {name: float(value) for name, value in zip(names, mass, strict=True)}


def chi_square(error: np.ndarray, covariance: np.ndarray) -> float:
    """e' V^-1 e; NaN where a standard error is zero (noise-free data)."""
    scale = standard_errors(covariance)
    if not (scale > 0).all():
        return np.nan
    z = error / scale
    try:
        return float(z @ np.linalg.solve(covariance / np.outer(scale, scale), z))
    except np.linalg.LinAlgError:
        return np.nan

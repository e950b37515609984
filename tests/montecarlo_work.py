"""A Monte Carlo without a laboratory: small linear regressions whose errors are known."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from tulip_testbed.base.table_files import Columns
from tulip_testbed.experiments.montecarlo.laboratory_runs import stream_of
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo, Settings
from tulip_testbed.experiments.montecarlo.montecarlo_run import collect
from tulip_testbed.experiments.montecarlo.run_columns import Layout, RunChunks, numbers_of, read_runs
from tulip_testbed.identification.estimators import Estimate

LAYOUT = Layout(("a.x", "b.x", "c.x"), {"full": (1, 2, 3), "simplified": (1, 3)})
TRUTH = np.array([0.1, 0.0, -0.3])
ROWS = 20


@dataclass(frozen=True)
class Regressions:
    """Least squares on `ROWS` data points; reports `factor` times its standard error, adds `shift` of them.

    Attributes:
        failing: runs that fail.
    """

    seed: int = 1
    factor: float = 1.0
    shift: float = 0.0
    failing: tuple[int, ...] = ()

    def __call__(self, runs: Sequence[int]) -> Columns:
        records = [self.record(run) for run in runs]
        columns = {name: np.array([record[name] for record in records]) for name in records[0]}
        failure = np.array(["too little" if run in self.failing else "" for run in runs])
        counts = {"rows": np.full(len(runs), ROWS), "dropped": np.zeros(len(runs), dtype=int)}
        return {"run": np.array(runs), **counts, **columns, "failure": failure}

    def record(self, run: int) -> dict[str, float]:
        if run in self.failing:
            return dict.fromkeys(LAYOUT.columns(), np.nan)
        rng = np.random.default_rng(stream_of(self.seed, run))
        matrix = rng.standard_normal((ROWS, 3))
        output = matrix @ TRUTH + 0.01 * rng.standard_normal(ROWS)
        models = {name: self.fit(matrix, output, numbers) for name, numbers in LAYOUT.models.items()}
        mass = (23.0 + 0.1 * rng.standard_normal(), 0.1, ROWS - 1, 23.0)
        return numbers_of(LAYOUT, models, TRUTH, mass)

    def fit(self, matrix: np.ndarray, output: np.ndarray, numbers: tuple[int, ...]) -> Estimate:
        kept = matrix[:, np.array(numbers) - 1]
        value, squares, *_ = np.linalg.lstsq(kept, output, rcond=None)
        dof = len(output) - len(value)
        covariance = squares[0] / dof * np.linalg.inv(kept.T @ kept)
        stated = self.factor**2 * covariance
        return Estimate(
            numbers=np.array(numbers),
            names=tuple(LAYOUT.names[n - 1] for n in numbers),
            value=value + self.shift * np.sqrt(np.diag(covariance)),
            covariance=stated,
            clustered_covariance=stated,
            residual=output - kept @ value,
            sigma=float(np.sqrt(squares[0] / dof)),
            placement_sd=(0.0, 0.0),
            dof=dof,
            interval_dof=np.full(len(value), float(dof)),
            joint_dof=dof,
            condition_number=float(np.linalg.cond(kept)),
        )


def run_regressions(folder: Path, runs: int, size: int, work: Regressions, workers: int = 1) -> RunChunks:
    """Carry out what is missing in a folder of chunks."""
    chunks = RunChunks(folder, runs, size)
    collect(chunks, work, lambda count: None, workers)
    return chunks


def result_of(chunks: RunChunks) -> MonteCarlo:
    """Judge the runs of a folder of chunks; there are neither laboratory nor plan."""
    settings = Settings(chunks.runs, 1, "stand-in", None, imperfections=0)
    document: Any = SimpleNamespace(settings=settings)
    return MonteCarlo.of(read_runs(chunks, LAYOUT), LAYOUT, document, plan=None, robot=None)


def bytes_of(chunks: RunChunks) -> list[bytes]:
    return [chunks.path(index).read_bytes() for index in range(len(chunks))]

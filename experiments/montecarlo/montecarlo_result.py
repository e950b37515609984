"""The result of a Monte Carlo: its figures are a JSON document, and its folder holds the runs behind them."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from tulip_testbed.base.errors import InputError, at_least, at_most, look_up, shortened
from tulip_testbed.base.machine import machine
from tulip_testbed.base.numbers import number
from tulip_testbed.base.result import Outside, Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import Columns, software, write_json
from tulip_testbed.experiments.defaults import ORDINARY
from tulip_testbed.experiments.identification_result import ESTIMATORS
from tulip_testbed.experiments.imperfections import imperfections_line
from tulip_testbed.experiments.laboratory import ENGINES, Laboratory
from tulip_testbed.experiments.montecarlo import coverage, coverage_verdict
from tulip_testbed.experiments.montecarlo.coverage import Coverage, Errors, ModelCoverage
from tulip_testbed.experiments.montecarlo.coverage_verdict import CoverageCheck
from tulip_testbed.experiments.montecarlo.run_columns import (
    Layout,
    RunChunks,
    errors_of,
    identified,
    layout_of,
    matrix,
    read_runs,
)
from tulip_testbed.experiments.parameter_tables import usable_line
from tulip_testbed.experiments.run_file import (
    PLAN_FOLDER,
    ROBOT,
    RUN_FILE,
    VERSION,
    Head,
    check_robot,
    configuration_of,
)
from tulip_testbed.experiments.usable_plan import plan_hash, planned_parameters
from tulip_testbed.identification.statistics import WELL_IDENTIFIED, relative_standard_errors
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.random_robots import check_spread
from tulip_testbed.sim.robot import Robot

CHUNK = 25  # runs a file: some seconds of work
MOST_RUNS = 1_000_000
CHUNK_FOLDER, REPORT_FILE = "runs", "report.json"


@dataclass(frozen=True)
class Settings:
    """Everything except laboratory and plan that the results depend on, as run.json has it.

    Attributes:
        robot_spread: of random true robots (`sim.random_robots`); None: the nominal robot.
        engine: "statics", or "dynamics": every run is held in the full dynamics.
        imperfections: scale of the ordinary imperfections of every run's laboratory; 0: it is exact.
    """

    runs: Annotated[int, Field(ge=1, le=MOST_RUNS)]
    seed: Annotated[int, Field(ge=0)]
    estimator: str
    robot_spread: Annotated[float, Field(gt=0, le=1)] | None
    engine: Annotated[str, Field(pattern="^(statics|dynamics)$")] = "statics"
    imperfections: Annotated[float, Field(ge=0)] = ORDINARY

    @property
    def chunk(self) -> int:
        """Return the runs in a file; one run of the dynamics takes a minute, and a kill costs no more."""
        return 1 if self.engine == "dynamics" else CHUNK

    def check(self) -> None:
        at_least("runs", self.runs, 1)
        at_most("runs", self.runs, MOST_RUNS)
        at_least("seed", self.seed, 0)
        look_up("estimator", self.estimator, ESTIMATORS, "estimator")
        look_up("engine", self.engine, ENGINES, "engine")
        if self.robot_spread is not None:
            check_spread(self.robot_spread)


@dataclass(frozen=True, kw_only=True)
class MonteCarloFile(Head):
    """run.json of a Monte Carlo: everything that its runs depend on."""

    settings: Settings
    configuration: dict[str, Any]
    inputs: dict[str, str]
    software: dict[str, str]
    machine: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MonteCarlo(Result, ModelCoverage):
    """Many runs of one experiment, and whether the errors are as large as the estimator states [m; kg].

    The full model's figures are the result's own, those of the simplified model are in `simplified`.

    Attributes:
        runs: how many. estimator, imperfections: see `Settings`.
        total_mass: its errors [kg].
        identified: how many runs could be. failures: how many could not, by reason.
        verdict: "pass", "fail" if any check fails, or "inconclusive" if the runs are too few for a pass.
        shown: whether there are enough runs to show that all checks hold.
        usable: what such an experiment gives, in a sentence.
        document: run.json. every_run: the columns of the run folder, all runs. plan, robot: of the runs.
        folder: of the runs; None: in memory alone.
    """

    kind: ClassVar[str] = "Monte Carlo"
    exit_codes: ClassVar = {"fail": 1, "inconclusive": 3}
    runs: int
    estimator: str
    imperfections: float
    simplified: ModelCoverage
    total_mass: Coverage
    identified: int
    failures: dict[str, int]
    checks: list[CoverageCheck]
    verdict: Literal["pass", "inconclusive", "fail"]
    shown: bool
    usable: str
    document: Annotated[MonteCarloFile, Outside()]
    every_run: Annotated[Columns, Outside()]
    plan: Annotated[PosturePlan, Outside()]
    robot: Annotated[Robot, Outside()]
    folder: Annotated[Path | None, Outside()] = None

    @property
    def models(self) -> dict[str, ModelCoverage]:
        """Return the models that the robot has, by name."""
        return {"full": self} | ({"simplified": self.simplified} if self.simplified.parameters else {})

    @property
    def errors_mm(self) -> dict[str, np.ndarray]:
        """Return estimate minus truth of every identified run by model, (runs, p) [mm]."""
        runs = identified(self.every_run)
        return {
            name: 1e3 * errors_of(runs, name, [row.number for row in model.parameters])
            for name, model in self.models.items()
        }

    def table(self) -> Table:
        """Return bias, ratio of standard errors and coverage of the full model's parameters."""
        return coverage.coverage_table("full", self.parameters)

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row per parameter of the full model, indexed by name."""
        return self.table().frame().set_index("parameter")

    @property
    def answers(self) -> tuple[str, str, str]:
        """Say whether the estimator is right, what this experiment gives, and what to do next."""
        if not self.identified:
            return "Is it right? no run could be identified.", self.usable, "Next: other postures."
        failed = ", ".join(check.name for check in self.checks if check.result == "fail")
        right, following = {
            "pass": (f"yes, {self.identified} runs show it", "measure the plan (`protocol`)"),
            "fail": (f"no, its standard errors are wrong: {failed}", "compare another `estimator`"),
            "inconclusive": (
                f"undecided, no check failed, but {self.identified} runs are too few to show that all hold",
                "ask for more runs in the same folder; coverage needs some 5000",
            ),
        }[self.verdict]
        return f"Is it right? {right}.", self.usable, f"Next: {following}."

    def tables(self) -> list[Table | str]:
        return [
            *(coverage.coverage_table(name, model.parameters) for name, model in self.models.items()),
            coverage.LEGEND,
            "",
            *self.lines(),
            "",
            coverage_verdict.coverage_check_table(self.checks),
            f"Verdict: {self.verdict}; estimator {self.estimator}, {self.runs} runs",
            *self.answers,
        ]

    def lines(self) -> list[str]:
        """Describe the total mass, the errors of all parameters together, and the runs that failed."""
        lines = [imperfections_line(self.imperfections, several=True)]
        for name, model in self.models.items():
            if beyond := model.beyond_95:
                low, high = (100 * end for end in beyond.interval)
                lines.append(
                    f"Runs whose errors together exceed 95 % of F, {name} model: {100 * beyond.share:.1f} % "
                    f"({low:.1f} to {high:.1f})."
                )
        if self.identified:
            mass = self.total_mass
            lines.append(
                f"Total mass: bias {number(1e3 * mass.bias, '+.2f')} g, its s.e. "
                f"{number(1e3 * mass.bias_mc_error, '.2f') or '-'} g; found over stated s.e. "
                f"{number(mass.standard_error_ratio, '.3f') or '-'}, coverage of 95 % intervals "
                f"{100 * mass.coverage95:.1f} %."
            )
        return lines + [f"{count} runs not identified: {reason}" for reason, count in self.failures.items()]

    def write_into(self, folder: Path) -> None:
        """Write a run folder, which more runs can be added to."""
        begin(folder, self.plan, self.robot)
        self.document.write(folder / RUN_FILE)
        chunks = RunChunks(folder / CHUNK_FOLDER, self.runs, self.document.settings.chunk)
        for index in range(len(chunks)):
            rows = list(chunks.runs_of(index))
            chunks.write({name: values[rows] for name, values in self.every_run.items()})
        write_json(folder / REPORT_FILE, self.to_json())

    @classmethod
    def load(cls, folder: str | Path, *context: Any) -> Self:
        """Read a run folder; the figures are computed again from its runs.

        Args:
            context: the robot.

        Raises:
            InputError: another kind or version of run, another robot's, one without its plan, an unfinished
                one.
        """
        folder, (robot,) = Path(folder), context
        document = MonteCarloFile.read(folder / RUN_FILE)
        settings = document.settings
        check_robot(folder, document.inputs, robot)
        plan = read_plan(folder / PLAN_FOLDER, robot)
        if (found := plan_hash(plan)) != (expected := document.inputs.get("plan", "none")):
            raise InputError(
                f"{folder / PLAN_FOLDER}: hash mismatch: found a plan with sha256 {found[:12]}..., expected "
                f"{shortened(expected[:12])}... by {RUN_FILE}"
            )
        chunks = RunChunks(folder / CHUNK_FOLDER, settings.runs, settings.chunk)
        if (done := chunks.done()) < settings.runs:
            raise InputError(
                f"{folder}: holds {done} of {settings.runs} runs; the command that made it does the rest"
            )
        layout = layout_of(robot, planned_parameters(robot, plan))
        return cls.of(read_runs(chunks, layout), layout, document, plan=plan, robot=robot, folder=folder)

    @classmethod
    def of(cls, every_run: Columns, layout: Layout, document: MonteCarloFile, **beside: Any) -> Self:
        """Compute the figures; the same bits for the same runs.

        Args:
            every_run: columns of `layout`, rows, dropped and failure. beside: plan, robot, folder.
        """
        settings, runs = document.settings, identified(every_run)
        kept = layout.models.items()
        models, judged = (
            {name: coverage.model_errors(runs, name, numbers, given) for name, numbers in kept}
            for given in (False, True)
        )
        covered = {name: coverage.model_coverage(errors, layout.names) for name, errors in models.items()}
        error = matrix(runs, ["mass"]) - matrix(runs, ["true_mass"])
        of_mass = coverage.summarise_errors(error, matrix(runs, ["mass_se"]), matrix(runs, ["mass_dof"]))
        left_out = {name: set(layout.numbers) - set(numbers) for name, numbers in kept}
        outside = {
            name: max((float(np.abs(runs[f"truth.{n}"]).max(initial=0.0)) for n in numbers), default=0.0)
            for name, numbers in left_out.items()
        }
        done = coverage_verdict.checks(settings.runs, judged, outside)
        return cls(
            runs=settings.runs,
            estimator=settings.estimator,
            imperfections=float(settings.imperfections),
            **covered["full"],
            simplified=ModelCoverage(**covered.get("simplified", {"parameters": []})),
            total_mass=Coverage(*coverage.coverage_of(of_mass)[0]),
            identified=models["full"].count,
            failures=dict(Counter(str(reason) for reason in every_run["failure"] if reason)),
            checks=done,
            verdict=coverage_verdict.verdict(done),
            shown=coverage_verdict.shown(done),
            usable=_usable(runs, models["full"], beside["robot"], beside["plan"]),
            document=document,
            every_run=every_run,
            **beside,
        )


def begin(folder: Path, plan: PosturePlan, robot: Robot) -> None:
    """Write everything but the runs into a new folder."""
    (folder / CHUNK_FOLDER).mkdir()
    write_plan(folder / PLAN_FOLDER, plan)
    ROBOT.write(folder / ROBOT.name, robot)


def _usable(runs: Columns, full: Errors, robot: Robot, plan: PosturePlan) -> str:
    """Say how many parameters are well identified, and how well the centre of mass is known in the plan."""
    if not full.count:
        return "Usable: nothing."
    numbers = full.numbers.tolist()
    truth, parameters = matrix(runs, [f"truth.{n}" for n in numbers]), planned_parameters(robot, plan)
    moved = parameters.regressor(plan.joint_angles, plan.support) @ errors_of(runs, "full", numbers).T
    shares = relative_standard_errors(truth.mean(axis=0), full.standard_error)
    return usable_line(shares < WELL_IDENTIFIED, float(np.sqrt((moved**2).mean())))


def montecarlo_file(laboratory: Laboratory, plan: PosturePlan, settings: Settings) -> MonteCarloFile:
    return MonteCarloFile(
        format="tulip-montecarlo",
        version=VERSION,
        command="montecarlo",
        settings=settings,
        configuration=configuration_of(laboratory, plan, settings.seed, settings.engine),
        inputs=laboratory.robot.hashes | {"plan": plan_hash(plan)},
        software=software(),
        machine=machine(),
    )

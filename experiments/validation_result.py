"""The result of a validation: estimates, the truth, checks and the verdict."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, Field, computed_field

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.numbers import number
from tulip_testbed.base.result import RESULT_FILE, Array, Kept, Place
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.checks import Check, check_table, verdict, worst_balance
from tulip_testbed.experiments.correlations import correlation_table
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.imperfections import imperfections_line
from tulip_testbed.experiments.parameter_tables import (
    LEGEND,
    mass_line,
    models,
    parameter_table,
    read_reported,
)
from tulip_testbed.experiments.run_file import (
    MADE,
    MEASUREMENT_FOLDER,
    PLAN_FOLDER,
    ROBOT,
    RunFile,
    SavedRun,
)
from tulip_testbed.experiments.simulate import DroppedPosture, SimulatedTruth, usable_postures
from tulip_testbed.measurements import Measurements, PosturePlan, read_measurements, write_measurements
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.robot import Robot

TRUTH_FILE = "truth.json"
MEASURED = Kept(MEASUREMENT_FOLDER, write_measurements, lambda folder, robot: read_measurements(folder))
TRUTH = Kept(TRUTH_FILE, lambda path, truth: truth.write(path), lambda path, robot: SimulatedTruth.read(path))


def _each_once(checks: tuple[Check, ...]) -> tuple[Check, ...]:
    if len({check.name for check in checks}) < len(checks):
        raise ValueError("each check once")
    return checks


@dataclass(frozen=True, eq=False, repr=False)
class Validation(SavedRun):
    """A run compared with its truth; prints parameters, checks and the verdict.

    Attributes:
        identification: the estimates from the measurements, which are judged.
        least_squares: the paper's estimates from the same measurements; None where they cannot be used.
        truth: base parameters of the robot that stood there, (p,) [m].
        checks: what was judged. wall_s: wall time [s].
        imperfections: scale of those that were drawn for the laboratory; 0: it is exact.
        robot: the nominal one. plan, measurements: of the experiment.
        simulation: what only the simulation knows.
        document: how it was made. folder: where it is saved; None: in memory alone.
    """

    kind = "validation"
    exit_codes: ClassVar = {"fail": 1}

    identification: Identification
    least_squares: Identification | None
    truth: Array
    checks: Annotated[tuple[Check, ...], AfterValidator(_each_once)]
    wall_s: float
    imperfections: float
    robot: Annotated[Robot, ROBOT, Field(exclude=True)]
    plan: Annotated[PosturePlan, Kept(PLAN_FOLDER, write_plan, read_plan)]
    measurements: Annotated[Measurements, MEASURED]
    simulation: Annotated[SimulatedTruth, TRUTH]
    document: Annotated[RunFile, MADE]
    folder: Place = None

    def placed_in(self, folder: Path) -> Self:
        result, robot, measured = folder / RESULT_FILE, self.robot, self.measurements
        own = self.identification.placed(robot, measured, str(result), "identification.")
        plain = self.least_squares
        plain = None if plain is None else plain.placed(robot, measured, str(result), "least_squares.")
        if self.truth.shape != (count := len(own.parameters.names),):
            raise InputError(f"{result}: key 'truth': found {self.truth.size} numbers, expected {count}")
        self.simulation.check(own.parameters.tree.links, measured, folder / TRUTH_FILE)
        return replace(self, identification=own, least_squares=plain)

    @computed_field
    @property
    def verdict(self) -> str:
        """ "pass", or "fail" if any check fails."""
        return verdict(self.checks)

    @computed_field
    @property
    def postures_planned(self) -> int:
        """Return how many postures were planned."""
        return self.plan.postures

    @computed_field
    @property
    def postures_used(self) -> int:
        """Return how many of them could be measured."""
        return self.plan.postures - len(self.simulation.dropped)

    @computed_field
    @property
    def dropped(self) -> tuple[DroppedPosture, ...]:
        """Return the postures that could not be measured."""
        return tuple(DroppedPosture(posture, reason) for posture, reason in self.simulation.dropped)

    @computed_field
    @property
    def true_mass(self) -> float:
        """Return the mass of the robot that stood there [kg]."""
        return self.simulation.mass

    @computed_field
    @property
    def books(self) -> dict[str, float] | None:
        """Return the largest imbalance of any hold; None in statics."""
        return worst_balance(self.simulation)

    def table(self) -> Table:
        return check_table(self.checks)

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with one row per parameter of the full model, with its truth.

        The checks are plain records: `pandas.DataFrame(validation.checks)`.
        """
        own = self.identification
        return parameter_table("full", own.full, own.parameters, self.truth).frame().set_index("parameter")

    @property
    def answers(self) -> tuple[str, str, str]:
        """Say whether the estimator is right, what of the estimate can be used, and what to do next."""
        results = {check.name: check.result for check in self.checks if check.result != "not evaluated"}
        if failed := [name for name, result in results.items() if result == "fail"]:
            return (
                f"Is it right? no, {len(failed)} of {len(results)} checks failed: {', '.join(failed)}.",
                "Usable: nothing, until the cause is found.",
                "Next: repeat with another `seed`; some 4 % of correct laboratories fail by chance.",
            )
        return (
            f"Is it right? yes, within the standard errors: all {len(results)} evaluated checks passed. "
            "Effects that the simulator does not model are not ruled out.",
            self.identification.usable,
            "Next: `montecarlo` tests whether the standard errors are too large; `plan optimal` finds "
            "postures that determine more.",
        )

    def tables(self) -> list[Table | str]:
        parts: list[Table | str] = []
        for model in models(self.robot):
            parts += [self.parameter_table(model), self.correlation_table(model), ""]
        reasons, paper = [one.reason for one in self.dropped], self.robot.settings.get("paper")
        parts += [
            LEGEND,
            imperfections_line(self.imperfections),
            *usable_postures(len(self.plan), len(self.measurements), reasons, paper),
            mass_line(*self.identification.mass, self.true_mass),
        ]
        if self.books is not None:
            sag = 1e3 * np.abs([held.joint_angles - held.commanded for held in self.simulation.held])
            torque = np.abs([held.torques for held in self.simulation.held]).max()
            shown = {name: number(value, ".2g") for name, value in self.books.items()}
            parts += [
                f"Difference between joint angles and commands: median {np.median(sag):.1f} mrad, largest "
                f"{sag.max():.1f} mrad; largest torque {torque:.1f} Nm.",
                f"Largest imbalance in any hold: cells against weight {shown['weight']} N, plates' moments "
                f"against the feet's wrench {shown['moments']} Nm, torques against statics "
                f"{shown['torques']} Nm, CoP against CoM {number(1e3 * self.books['centre'], '.2g')} mm, "
                f"energy left in motion {shown['kinetic']} J.",
            ]
        return [*parts, "", self.table(), f"Verdict: {self.verdict} after {self.wall_s:.0f} s", *self.answers]

    def parameter_table(self, model: str) -> Table:
        """Return the parameters of a model with their truth and, where there is one, the paper's Table II."""
        own, plain = self.identification, self.least_squares
        return parameter_table(
            model,
            getattr(own, model),
            own.parameters,
            self.truth,
            read_reported(self.robot),
            least_squares=None if plain is None else getattr(plain, model),
        )

    def correlation_table(self, model: str) -> Table | str:
        """Return the high correlations of a model by least squares, or that there are none.

        Eq. 15 is of least squares: priors of imperfections would hide what postures do not distinguish.
        """
        shown = self.least_squares or self.identification
        pairs, angles = getattr(shown, model).high_correlations, self.measurements.joint_angles
        return correlation_table(model, pairs, shown.parameters, angles)

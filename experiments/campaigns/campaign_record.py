"""The folder of a campaign: its configuration, one folder an experiment, and run.json when it has ended."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from pydantic import Field

from tulip_testbed.base.alone import alone_in
from tulip_testbed.base.document import Count, Document, Figure, Seed
from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import check_new, new_folder, present
from tulip_testbed.base.machine import machine
from tulip_testbed.base.table_files import read_json, software
from tulip_testbed.experiments.discovery_record import REPORT_FILE
from tulip_testbed.experiments.run_file import (
    PLAN_FOLDER,
    RUN_FILE,
    VERSION,
    Configuration,
    RunFile,
    check_configuration,
    check_files,
    check_outputs,
    check_robot,
    write_run_file,
)
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.robot import Robot

CAMPAIGN_FILE, STEP_FILE = "campaign.json", "step.json"
MEASUREMENTS, PLAN, DISCOVERY = "measurements", "plan", "discovery"


class CampaignSettings(Document):
    """The settings of a campaign: budget in experiments and minutes of laboratory time, None: no limit."""

    seed: Seed
    engine: str
    experiments: Count
    minutes: float | None
    imperfections: float


class CampaignConfiguration(Configuration):
    """Everything that a campaign's results depend on; effects: what is hidden in the laboratory."""

    settings: CampaignSettings
    effects: list[str]


class KnownThen(Document):
    """An explanation of a gap and its posterior probability after an experiment."""

    gap: int
    label: str
    probability: float


class ParameterThen(Document):
    """A base parameter after an experiment, and the truth [mm]."""

    number: int
    name: str
    estimate_mm: float
    standard_error_mm: float
    truth_mm: float


class Step(Document):
    """One experiment and what was known after it; entropies in nats.

    expected_entropy: as `tulip next` expected it before the experiment; None for the first one.
    files: sha256 of the experiment's files.
    """

    number: int
    session: str
    manipulations: list[str]
    postures: int
    rows: int
    minutes: float
    verdict: str
    story: list[str] = Field(min_length=1)
    adopted: list[str]
    explanations: list[KnownThen]
    entropy: Figure
    expected_entropy: Figure
    parameters: list[ParameterThen]
    error_mm: float
    error_over_standard_error: float
    wall_s: float
    files: dict[str, str] = Field(default_factory=dict)

    @property
    def words(self) -> str:
        """Describe the manipulations."""
        return ", ".join(self.manipulations) or ("first experiment" if self.number == 1 else "more postures")


@dataclass(frozen=True)
class CampaignRecord:
    """A campaign as its folder holds it.

    Attributes:
        document: run.json. steps: the experiments in order. plan: that of the first one.
    """

    kind: ClassVar[str] = "campaign"
    document: RunFile[CampaignConfiguration]
    steps: tuple[Step, ...]
    plan: PosturePlan
    robot: Robot
    folder: Path | None

    @property
    def ended(self) -> str:
        """Return why the campaign ended."""
        last, count = self.steps[-1], len(self.steps)
        several = "one experiment" if count == 1 else f"{count} experiments"
        if last.verdict != "ambiguous":
            return f"After {several} the verdict is {last.verdict}."
        return f"The budget ended after {several}; several explanations are left."


def campaign_file(
    configuration: CampaignConfiguration, inputs: dict[str, str]
) -> RunFile[CampaignConfiguration]:
    """Make the document of a campaign, without outputs."""
    return RunFile[CampaignConfiguration](
        format="tulip-run",
        version=VERSION,
        command="campaign",
        configuration=configuration,
        software=software(),
        machine=machine(),
        inputs=inputs,
    )


@contextmanager
def open_campaign(
    folder: Path, document: RunFile[CampaignConfiguration], plan: PosturePlan
) -> Iterator[list[Step]]:
    """Make the folder of a campaign or find one that was stopped, and keep others out.

    Yields:
        the experiments that are done.

    Raises:
        InputError: the folder holds something else, another configuration, or a campaign that has ended; or
            another process is at work in it.
    """
    if present(folder):
        _check_same(folder, document)
    else:
        check_new(folder)
        with new_folder(folder) as working:
            write_plan(working / PLAN_FOLDER, plan)
            document.write(working / CAMPAIGN_FILE)
    with alone_in(folder, CAMPAIGN_FILE):
        yield _done(folder)


def _check_same(folder: Path, document: RunFile[CampaignConfiguration]) -> None:
    if present(folder / RUN_FILE):
        raise InputError(f"{folder}: holds a run that has ended ({RUN_FILE}); give a new name")
    if not present(folder / CAMPAIGN_FILE):
        raise InputError(f"{folder}: exists already and holds no campaign ({CAMPAIGN_FILE}); give a new name")
    check_configuration(folder / CAMPAIGN_FILE, document, "a campaign")


def _done(folder: Path) -> list[Step]:
    """Read the experiments that are done.

    Raises:
        InputError: a file of theirs is not what was written, or a folder is none of theirs.
    """
    steps: list[Step] = []
    while present(here := folder / str(len(steps) + 1)):
        if not present(here / STEP_FILE):
            raise InputError(f"{here}: found no {STEP_FILE}, expected one of the campaign's experiments")
        step = Step.read(here / STEP_FILE)
        check_files(here, step.files, STEP_FILE)
        found = read_json(here / DISCOVERY / REPORT_FILE).get("verdict")
        if step.verdict != found:
            raise InputError(
                f"{here / STEP_FILE}: key 'verdict': found {shortened(step.verdict)}, "
                f"expected {found} by its discovery"
            )
        steps.append(step)
    return steps


def end_campaign(folder: Path, document: RunFile[CampaignConfiguration]) -> None:
    """Write run.json with the hashes of all files."""
    write_run_file(folder, document)


def read_campaign(folder: Path, robot: Robot) -> CampaignRecord:
    """Read a campaign that has ended and check that its files are what was written.

    Raises:
        InputError: another kind or version of run, another robot's, or a file that is not what was written.
    """
    folder = Path(folder)
    document = RunFile[CampaignConfiguration].read(folder / RUN_FILE)
    check_robot(folder, document.inputs, robot)
    check_outputs(folder, document.outputs, (CAMPAIGN_FILE, f"1/{STEP_FILE}"))
    steps, number = [], 1
    while f"{number}/{STEP_FILE}" in document.outputs:
        steps.append(Step.read(folder / str(number) / STEP_FILE))
        number += 1
    return CampaignRecord(document, tuple(steps), read_plan(folder / PLAN_FOLDER, robot), robot, folder)

"""Simulate, discover, propose, simulate: until one explanation is left or the budget ends."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tulip_testbed.base.errors import InputError, at_least
from tulip_testbed.base.files import new_folder
from tulip_testbed.base.table import Shown, Table
from tulip_testbed.calibration.calibrated_estimate import SELF_CALIBRATING
from tulip_testbed.discovery.experiment_information import entropy, probabilities
from tulip_testbed.discovery.next_experiment import minutes_of
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.experiments.campaigns.campaign_record import (
    DISCOVERY,
    MEASUREMENTS,
    PLAN,
    STEP_FILE,
    CampaignConfiguration,
    CampaignRecord,
    CampaignSettings,
    KnownThen,
    ParameterThen,
    Step,
    campaign_file,
    end_campaign,
    open_campaign,
    read_campaign,
)
from tulip_testbed.experiments.campaigns.campaign_tables import campaign_parts
from tulip_testbed.experiments.discovering import Discovered, discover_effects
from tulip_testbed.experiments.discovery_record import discovery_record, read_discovery, write_discovery
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.imperfections import check_imperfections, drawn, single_stream
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.montecarlo_folder import plan_hash
from tulip_testbed.experiments.proposed_experiment import next_of, read_experiment, write_experiment_plan
from tulip_testbed.experiments.run_file import configuration_of, hashes_in
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.statistics import standard_errors
from tulip_testbed.measurements import Experiment, PosturePlan, joined, read_measurements, write_measurements
from tulip_testbed.sim.plan_folder import read_plan, write_plan

SESSION = "campaign"
AMBIGUOUS = "ambiguous"


def campaign_settings(
    seed: int, engine: str, experiments: int, minutes: float | None, imperfections: float
) -> CampaignSettings:
    """Return what is asked of a campaign.

    Raises:
        InputError: a number that cannot be.
    """
    at_least("seed", seed, 0)
    at_least("experiments", experiments, 1)
    if minutes is not None and not 0 < minutes < np.inf:
        raise InputError(f"minutes: found {minutes:g}, expected a finite number above 0")
    return CampaignSettings(
        seed=seed,
        engine=engine,
        experiments=experiments,
        minutes=None if minutes is None else float(minutes),
        imperfections=float(imperfections),
    )


@dataclass(frozen=True, eq=False, repr=False)
class Campaign(Shown):
    """A campaign that has ended: the experiments, and what was known after each.

    Attributes:
        record: as the folder holds it; its folder is None if none was asked for.
    """

    record: CampaignRecord

    @property
    def steps(self) -> tuple[Step, ...]:
        """The experiments in order."""
        return self.record.steps

    @property
    def verdict(self) -> str:
        """The last verdict."""
        return self.steps[-1].verdict

    def parts(self) -> list[Table | str]:
        """Return the story, the experiments and the explanations."""
        return campaign_parts(self.record)


def campaign(
    laboratory: Laboratory,
    plan: PosturePlan,
    settings: CampaignSettings,
    folder: Path | None = None,
    progress: Callable[[str], None] = lambda what: None,
    tolerances: Mapping[str, float] | None = None,
) -> Campaign:
    """Carry out a campaign; the same call goes on where one was stopped.

    Args:
        laboratory: with what is hidden in it. plan: of the first experiment; the postures of the others are
            chosen from it.
        folder: of the campaign; None: a temporary one.
        progress: called with what is done next.
        tolerances: see `discover_effects`.

    Raises:
        InputError: what cannot be run, or a folder that holds something else.
    """
    check_imperfections(laboratory, settings.imperfections)
    first = minutes_of(Experiment(), *_size(plan))
    if settings.minutes is not None and settings.minutes < first:
        raise InputError(
            f"minutes: found {settings.minutes:g}, expected {first:g} or more for the first experiment"
        )
    inside = drawn(laboratory, settings.imperfections, single_stream(settings.seed))
    inside.check(plan, settings.engine)
    made = configuration_of(laboratory, plan, settings.seed, settings.engine, settings.imperfections).plain()
    hidden = [str(one) for one in laboratory.hidden]
    configuration = CampaignConfiguration.model_validate(
        made | {"settings": settings.plain(), "effects": hidden}
    )
    document = campaign_file(configuration, laboratory.robot.hashes | {"plan": plan_hash(plan)})
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch) / "campaign" if folder is None else folder
        with open_campaign(place, document, plan) as steps:
            while not steps or not _ends(steps, settings):
                found = _carry_out(place, inside, plan, steps, settings, progress, tolerances)
                if found is None:
                    break
                steps.append(found)
            end_campaign(place, document)
        record = read_campaign(place, laboratory.robot)
    return Campaign(record if folder is not None else replace(record, folder=None))


def _ends(steps: list[Step], settings: CampaignSettings) -> bool:
    return steps[-1].verdict != AMBIGUOUS or len(steps) >= settings.experiments


def _carry_out(
    folder: Path,
    laboratory: Laboratory,
    plan: PosturePlan,
    steps: list[Step],
    settings: CampaignSettings,
    progress: Callable[[str], None],
    tolerances: Mapping[str, float] | None,
) -> Step | None:
    """Carry out the next experiment; None: there is no time for it."""
    began, robot = time.perf_counter(), laboratory.robot
    number, spent = len(steps) + 1, sum(step.minutes for step in steps)
    experiment, proposals, minutes = Experiment(SESSION), None, minutes_of(Experiment(), *_size(plan))
    if steps:
        progress(f"experiment {number}: what to measure")
        before = read_discovery(folder / str(number - 1) / DISCOVERY, robot)
        proposals = next_of(before, robot, plan, settings.seed)
        minutes = proposals.best.minutes
        if settings.minutes is not None and spent + minutes > settings.minutes:
            return None
    with new_folder(folder / str(number)) as here:
        if proposals is None:
            write_plan(here / PLAN, plan)
        else:
            write_experiment_plan(here / PLAN, proposals)
            plan, (experiment, _) = read_plan(here / PLAN, robot), read_experiment(here / PLAN)
        manipulations = ", ".join(experiment.manipulations) or "nothing changed"
        progress(f"experiment {number}: measuring ({manipulations})")
        inside = laboratory.manipulated(*experiment.manipulations, session=experiment.session)
        seed = int(np.random.SeedSequence([settings.seed, number]).generate_state(1)[0])
        run = inside.run(plan, seed, settings.engine, workers=1)
        write_measurements(here / MEASUREMENTS, run.measurements)
        places = [*(folder / str(k) for k in range(1, number)), here]
        every = [read_measurements(place / MEASUREMENTS) for place in places]
        progress(f"experiment {number}: looking for what is missing")
        found = discover_effects(joined(every), robot, settings.seed, check=False, tolerances=tolerances)
        write_discovery(here / DISCOVERY, discovery_record(found, MEASUREMENTS, settings.seed, True))
        expected = None if proposals is None else float(proposals.best.entropy[1])
        step = _step(found, number, experiment, len(plan), minutes, expected, laboratory, tolerances)
        made = {"wall_s": time.perf_counter() - began, "rows": len(every[-1]), "files": hashes_in(here)}
        step = step.model_copy(update=made)
        step.write(here / STEP_FILE)
    return step


def _size(plan: PosturePlan) -> tuple[int, int]:
    return len(np.unique(plan.placement)), len(plan)


def _step(
    found: Discovered,
    number: int,
    experiment: Experiment,
    postures: int,
    minutes: float,
    expected: float | None,
    laboratory: Laboratory,
    tolerances: Mapping[str, float] | None,
) -> Step:
    """Return what is known after an experiment, and how far the base parameters are from the truth."""
    discovery, measured = found.discovery, found.discovery.observed.measurements
    fit = found.after or identify(
        measured, found.robot, estimator=SELF_CALIBRATING, adopted=discovery.adopted, tolerances=tolerances
    )
    full, explanations, doubt = fit.full, list[KnownThen](), 0.0
    for gap, k in enumerate(discovery.effects, 1):
        several = discovery.equivalents[k]
        share = probabilities([one.log_bayes_factor for one in several])
        doubt += float(entropy(share))
        explanations += [
            KnownThen(gap=gap, label=one.label, probability=float(p))
            for one, p in zip(several, share, strict=True)
        ]
    truth = true_base_parameters(laboratory.rig, common_support(measured.support))
    errors = standard_errors(full.covariance)
    off = full.value - truth
    parameters = [
        ParameterThen(
            number=int(full.numbers[k]),
            name=full.names[k],
            estimate_mm=1e3 * float(full.value[k]),
            standard_error_mm=1e3 * float(errors[k]),
            truth_mm=1e3 * float(truth[k]),
        )
        for k in range(len(truth))
    ]
    return Step(
        number=number,
        session=experiment.session,
        manipulations=list(experiment.manipulations),
        postures=postures,
        rows=0,
        minutes=minutes,
        verdict=found.verdict,
        story=found.story[:2],
        adopted=[str(one) for one in discovery.adopted],
        explanations=explanations,
        entropy=doubt if found.verdict in (AMBIGUOUS, "named") else None,
        expected_entropy=expected,
        parameters=parameters,
        error_mm=1e3 * float(np.sqrt((off**2).mean())),
        error_over_standard_error=float(np.sqrt(((off / errors) ** 2).mean())),
        wall_s=0.0,
    )

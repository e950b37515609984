"""Does the proposed experiment settle what one experiment left ambiguous (docs/studies/next-experiment.md)?

Part `campaigns`: campaigns of at most three experiments in ordinary laboratories with random robots, in
which one of the effects that a single experiment confuses is hidden. Part `gains`: the expected gain of
proposed and random experiments against the realised one, averaged over five noise seeds. Both are resumable.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta, spearmanr

from studies.runner import Settings, shipped_plan
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.files import present, write_text
from tulip_testbed.calibration.ordinary_laboratory import ordinary_members
from tulip_testbed.discovery.candidate_search import Search, first_calibration
from tulip_testbed.discovery.candidates import Candidate, Fitted
from tulip_testbed.discovery.discover import AMBIGUOUS, Discovery, discover
from tulip_testbed.discovery.experiment_information import entropy, probabilities
from tulip_testbed.discovery.next_experiment import (
    ENOUGH,
    LEAST,
    Doubt,
    Prospect,
    doubts_of,
    pool_of,
    possible,
)
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.campaigns.campaign_record import CampaignSettings, read_campaign
from tulip_testbed.experiments.campaigns.campaign_run import Campaign, campaign
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.estimators import DEFAULT
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.statistics import standard_errors
from tulip_testbed.measurements import Experiment, Measurements, joined, read_measurements
from tulip_testbed.measurements.cells import CELLS
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot, load_robot

CAMPAIGNS, GAINS, RANDOM, SEEDS = 16, 4, 3, 5  # cases; random experiments and noise seeds of a case
ROBOTS = (0.05, 0.2)  # spread of masses and centres of mass
SESSION = "campaign"
PLACEMENTS = 20, 12  # of the first experiment, in both parts
BIASED = 2.0  # s.e., r.m.s. over the parameters, from which a bias was kept
SETTINGS = Settings(seed=17000, only=("campaigns", "gains"))


def study(settings: Settings) -> Iterator[str]:
    """Yield the tables of both parts."""
    folder = settings.folder("campaign")
    if "campaigns" in settings.only:
        cases = [(k, settings.seed, folder) for k in range(settings.count(CAMPAIGNS))]
        yield from _campaigns(settings.parallel("campaigns", carry_out, cases), folder)
    if "gains" in settings.only:
        cases = [(k, settings.seed, folder) for k in range(settings.count(GAINS))]
        found = [one for several in settings.parallel("gains", gains, cases) for one in several]
        yield from _gains(found)


def drawn_laboratory(robot: Robot, rng: np.random.Generator, ordinary: bool) -> Laboratory:
    """Draw a robot, an effect that one experiment confuses with another, and ordinary imperfections."""
    spread = float(rng.uniform(*ROBOTS))
    rig = preset_rig("force-plate", robot)
    rig = replace(rig, edit=edit_of(robot.model, draw_robot(robot.model, spread, rng)))
    members = ordinary_members(rig, rng, 1.0 if ordinary else 0.1)
    made = Laboratory(robot, "force-plate", nominal=rig)
    made = made.with_effects(_hidden(rng))
    kept = {one.label for one in made.hidden}
    return replace(made, hidden=made.hidden + tuple(m for m in members if m.label not in kept))


def _hidden(rng: np.random.Generator) -> str:
    kind, sign = rng.choice(["cell-tare", "tether", "tilt"], p=[0.5, 0.25, 0.25]), rng.choice([-1.0, 1.0])
    if kind == "cell-tare":
        return f"cell-tare:{rng.choice(CELLS)}={sign * rng.uniform(0.5, 1.5):.3f}"
    if kind == "tether":
        return f"tether={sign * rng.uniform(4, 8):.3f},{rng.uniform(-1, 1):.3f}"
    return f"tilt={np.radians(rng.uniform(-0.3, 0.3)):.5f},{sign * np.radians(rng.uniform(1.5, 3)):.5f}"


def carry_out(number: int, seed: int, folder: Path) -> dict[str, Any]:
    """Carry out one campaign; one that was stopped goes on."""
    kept = folder / f"campaign-{number}.json"
    if present(kept):
        return json.loads(kept.read_text())
    robot = load_robot()
    rng = np.random.default_rng([seed, number])
    made = drawn_laboratory(robot, rng, ordinary=number % 2 == 0)
    hidden = made.hidden[0]
    settings = CampaignSettings(seed=number, engine="statics", experiments=3, minutes=None, imperfections=0.0)
    place = folder / f"campaign-{number}"
    try:
        ended = place / "run.json"
        if present(ended):
            found = Campaign(read_campaign(place, robot))
        else:
            found = campaign(made, shipped_plan(robot, PLACEMENTS[0]), settings, place)
    except InputError as error:
        out = {"number": number, "hidden": str(hidden), "failed": str(error)}
    else:
        out = _judged(found, number, hidden)
    write_text(kept, json.dumps(out))
    return out


def bias_of(place: Path, robot: Robot) -> tuple[float, float]:
    """Return the r.m.s. error of the base parameters over their standard errors in the first experiment.

    By the estimator that knows no ordinary imperfections: without any effect, as after an ambiguous verdict,
    and with what the campaign adopted.
    """
    steps, first = read_campaign(place, robot).steps, read_measurements(place / "1" / "measurements")
    truth = 1e-3 * np.array([row.truth_mm for row in steps[0].parameters])
    found = []
    for adopted in ((), [EffectInstance.parse(text, robot) for text in steps[-1].adopted]):
        full = identify(joined([first]), robot, estimator=DEFAULT, adopted=adopted).full
        found.append(float(np.sqrt((((full.value - truth) / standard_errors(full.covariance)) ** 2).mean())))
    return found[0], found[1]


def _judged(found: Campaign, number: int, hidden: EffectInstance) -> dict[str, Any]:
    last = found.steps[-1]
    return {
        "number": number,
        "hidden": str(hidden),
        "verdicts": [step.verdict for step in found.steps],
        "said": [sorted({one.label for one in step.explanations}) for step in found.steps],
        "words": [step.words for step in found.steps],
        "expected": [step.expected_entropy for step in found.steps],
        "right": last.verdict == "named" and [one.split("=")[0] for one in last.adopted] == [hidden.label],
        "off": [step.error_over_standard_error for step in found.steps],
        "wall_s": sum(step.wall_s for step in found.steps),
        "failed": "",
    }


def _campaigns(found: list[dict[str, Any]], folder: Path) -> Iterator[str]:
    robot = load_robot()
    run = [one for one in found if not one["failed"]]
    doubtful = [one for one in run if one["verdicts"][0] == AMBIGUOUS]
    # The best proposal was expected to settle nearly all.
    separable = [one for one in doubtful if len(one["expected"]) > 1 and one["expected"][1] < 0.05]
    yield f"{len(run)} campaigns, {len(found) - len(run)} others could not be carried out; "
    yield f"{len(doubtful)} ambiguous after the first experiment, {len(separable)} of them separable.\n"
    bias = {one["number"]: bias_of(folder / f"campaign-{one['number']}", robot) for one in run}
    yield "| case | hidden | verdicts | experiments | right | error / s.e. | with what was adopted |"
    yield "|---|---|---|---|---|---|---|"
    for one in run:
        a, b = bias[one["number"]]
        yield (
            f"| {one['number']} | {one['hidden']} | {', '.join(one['verdicts'])} | {'; '.join(one['words'])} "
            f"| {'yes' if one['right'] else 'no'} | {a:.2f} | {b:.2f} |"
        )
    right = sum(one["right"] for one in separable)
    yield f"\nRight single name within two more experiments: {_share(right, len(separable))}."
    biased = [bias[one["number"]] for one in separable]
    removed = [(a**2 - b**2) / (a**2 - 1) for a, b in biased if a > BIASED]
    if removed:
        yield f"Bias removed where it was kept ({len(removed)} cases): median {np.median(removed):.2f}."
    spent = [one["wall_s"] for one in run]
    yield f"Seconds a campaign on one core: median {np.median(spent):.0f}, most {np.max(spent):.0f}."


def _share(good: int, count: int) -> str:
    """Write a share with its exact 95 % interval (Clopper-Pearson)."""
    if not count:
        return "no case"
    low = beta.ppf(0.025, good, count - good + 1) if good else 0.0
    high = beta.ppf(0.975, good + 1, count - good) if good < count else 1.0
    return f"{good} of {count} ({good / count:.2f}; {low:.2f} to {high:.2f})"


def gains(number: int, seed: int, folder: Path) -> list[dict[str, Any]]:
    """Compare expected and realised gains of the proposed and of random experiments in one laboratory."""
    kept = folder / f"gains-{number}.json"
    if present(kept):
        return json.loads(kept.read_text())
    robot = load_robot()
    plan = shipped_plan(robot, PLACEMENTS[1])
    for attempt in range(10):
        rng = np.random.default_rng([seed, 1, number, attempt])
        made = drawn_laboratory(robot, rng, ordinary=number % 2 == 0)
        first = _run(made, plan, Experiment(SESSION), int(rng.integers(2**31)))
        found = discover(joined([first]), robot, hold_out=False)
        doubts = doubts_of(found)
        if len(doubts) == 1:
            doubts = [_as_judged(doubts[0], joined([first]), robot)]
            break
    else:
        write_text(kept, "[]")
        return []
    out = []
    for prospect, chosen, proposed in _experiments(found, doubts, robot, rng):
        expected = prospect.chosen(chosen)
        realised = []
        for noise in rng.integers(2**31, size=SEEDS).tolist():
            second = _run(made, expected.plan, prospect.experiment, noise)
            logs = _evidence(joined([first, second]), robot, prospect.doubts[0])
            realised.append(doubts[0].entropy - float(entropy(probabilities(logs))))
        out.append(
            {
                "case": number,
                "hidden": str(made.hidden[0]),
                "words": expected.words,
                "postures": len(expected.plan),
                "proposed": proposed,
                "expected": expected.entropy[0] - expected.entropy[1],
                "realised": float(np.mean(realised)),
            }
        )
        write_text(folder / f"gains-{number}-so-far.json", json.dumps(out, default=float))
    write_text(kept, json.dumps(out, default=float))
    return out


def _run(made: Laboratory, plan: Any, experiment: Experiment, seed: int) -> Measurements:
    inside = made.manipulated(*experiment.manipulations, session=experiment.session)
    return inside.run(plan, seed, "statics", workers=1).measurements


def _experiments(
    found: Discovery, doubts: list[Doubt], robot: Robot, rng: np.random.Generator
) -> Iterator[tuple[Prospect, np.ndarray, bool]]:
    """Yield the best experiment and random ones, each with the indices of its placements."""
    now, calibration = found.observed, found.selection.calibration
    pool = pool_of(now, shipped_plan(robot, PLACEMENTS[1]))
    every = [
        Prospect.of(now, pool, calibration, doubts, Experiment(SESSION, texts))
        for texts in possible(now.measurements, robot, doubts)
    ]
    ranked = sorted(every, key=lambda one: -one.chosen(one.best_placements()).rate)
    yield ranked[0], ranked[0].best_placements(), True
    count = len(ranked[0].informations[0].numbers)
    for k in rng.permutation(len(ranked))[:RANDOM].tolist():
        size = int(rng.integers(LEAST, 12))
        yield ranked[k], np.sort(rng.permutation(count)[:size]), False


def _as_judged(doubt: Doubt, measured: Measurements, robot: Robot) -> Doubt:
    """Return a doubt whose explanations are weighed as `_evidence` does."""
    weighed = zip(doubt.explanations, _evidence(measured, robot, doubt), strict=True)
    return replace(doubt, explanations=tuple(replace(one, log_bayes_factor=log) for one, log in weighed))


def _evidence(measured: Measurements, robot: Robot, doubt: Doubt) -> list[float]:
    """Return ln of the evidence for each explanation in everything that was measured."""
    search = Search.of(observe(measured, nominal_robot(robot)))
    terms, logs = [_fitted(one.instance) for one in doubt.explanations], []
    start = first_calibration(search, terms[:1])
    for term in terms:
        judged = search.tried([term], start)
        logs.append(-1e6 if judged is None else judged.evidence)
    return logs


def _fitted(instance: EffectInstance) -> Fitted:
    candidate = Candidate(instance.effect, instance.target, np.array([instance.values]))
    return Fitted(candidate, 0, np.array([instance.values[k] for k in instance.effect.sizes]))


def _gains(found: list[dict[str, Any]]) -> Iterator[str]:
    yield "\n| case | experiment | postures | proposed | expected gain, nat | realised gain, nat |"
    yield "|---|---|---|---|---|---|"
    for one in found:
        yield (
            f"| {one['case']} | {one['words']} | {one['postures']} | {'yes' if one['proposed'] else 'no'} "
            f"| {one['expected']:.3f} | {one['realised']:.3f} |"
        )
    if len(found) > 2:
        rank = spearmanr([one["expected"] for one in found], [one["realised"] for one in found])
        yield (
            f"\nRank correlation over {len(found)} experiments: {rank.statistic:.2f} "
            f"(a separation of {ENOUGH:g} in ln BF counts as enough)."
        )

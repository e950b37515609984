"""Does the proposed experiment settle an ambiguous verdict (docs/studies/next-experiment.md)? Six minutes.

A campaign goes on until one explanation is left, or three experiments are done: simulate, discover, propose the
experiment that settles most per minute, simulate that. Its laboratory has a random robot, and an effect that
one experiment confuses with another; in every second one the ordinary imperfections are ten times smaller.
Campaigns that are done are kept; the same command carries out the others.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from studies.runner import Settings, header, row, share, shipped_plan
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.discovery.discover import AMBIGUOUS, NAMED
from tulip_testbed.experiments.discovering import discover_effects
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.imperfections import ordinary_members
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.estimators import MIXED_MODEL
from tulip_testbed.identification.statistics import standard_errors
from tulip_testbed.measurements import Experiment, joined
from tulip_testbed.measurements.cells import CELLS
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import Robot, load_robot

SETTINGS = Settings(seed=17000)
CAMPAIGNS, EXPERIMENTS, PLACEMENTS = 16, 3, 20  # placements of the first experiment
PRESET, SESSION = "force-plate", "campaign"
ROBOTS = (0.05, 0.2)  # spread of masses and centres of mass
SEPARABLE = 0.05  # nat of entropy that the best proposal is expected to leave at most
BIASED = 2.0  # s.e., r.m.s. over the parameters, from which a bias was kept


@dataclass(frozen=True)
class Campaign:
    """One campaign.

    Attributes:
        hidden: effect. failed: why it could not be carried out, or "".
        verdicts, words: of each experiment. expected: entropy that was expected after the second one [nat].
        right: whether the last verdict names what is hidden and nothing else.
        errors: of the base parameters by the first experiment over their standard errors, r.m.s.: without any
            effect, and with what was adopted at last.
    """

    hidden: str
    failed: str = ""
    verdicts: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    expected: float | None = None
    right: bool = False
    errors: tuple[float, float] = (0.0, 0.0)


def study(settings: Settings) -> Iterator[str]:
    """Yield the table of the campaigns."""
    folder = settings.folder("campaign")
    numbers = range(settings.count(CAMPAIGNS))
    calls = {folder / f"{number:03}.json": (number, settings.seed) for number in numbers}
    every = settings.kept("campaigns", campaign, calls)
    done = [one for one in every if not one.failed]
    doubtful = [one for one in done if one.verdicts[0] == AMBIGUOUS]
    separable = [one for one in doubtful if one.expected is not None and one.expected < SEPARABLE]
    yield f"{len(done)} campaigns, {len(every) - len(done)} others could not be carried out;"
    yield f"{len(doubtful)} ambiguous after the first experiment, {len(separable)} of them separable.\n"
    yield header("hidden", "verdicts", "experiments", "right", "error / s.e.", "with what was adopted")
    for one in done:
        words, right = "; ".join(one.words), "yes" if one.right else "no"
        errors = (f"{error:.2f}" for error in one.errors)
        yield row(one.hidden, ", ".join(one.verdicts), words, right, *errors)
    right = sum(one.right for one in separable)
    yield f"\nRight single name within two more experiments: {share(right, len(separable))}."
    removed = [(a**2 - b**2) / (a**2 - 1) for a, b in (one.errors for one in separable) if a > BIASED]
    if removed:
        yield f"Bias removed where it was kept ({len(removed)} cases): median {np.median(removed):.2f}."


def campaign(number: int, seed: int) -> Campaign:
    """Carry out a campaign in a laboratory of its own."""
    robot, rng = load_robot(), np.random.default_rng([seed, number])
    return carry_out(draw_laboratory(robot, rng, 1.0 if number % 2 == 0 else 0.1), number)


def draw_laboratory(robot: Robot, rng: np.random.Generator, imperfections: float) -> Laboratory:
    """Draw a robot, an effect that one experiment confuses with another, and ordinary imperfections."""
    spread = float(rng.uniform(*ROBOTS))
    rig = preset_rig(PRESET, robot)
    rig = replace(rig, edit=edit_of(robot.model, draw_robot(robot.model, spread, rng)))
    members = ordinary_members(rig, rng, imperfections)
    made = Laboratory(robot, PRESET, nominal=rig).with_effects(_hidden(rng))
    labels = {one.label for one in made.hidden}
    return replace(made, hidden=made.hidden + tuple(m for m in members if m.label not in labels))


def _hidden(rng: np.random.Generator) -> str:
    kind, sign = rng.choice(["cell-tare", "tether", "tilt"], p=[0.5, 0.25, 0.25]), rng.choice([-1.0, 1.0])
    if kind == "cell-tare":
        return f"cell-tare:{rng.choice(CELLS)}={sign * rng.uniform(0.5, 1.5):.3f}"
    if kind == "tether":
        return f"tether={sign * rng.uniform(4, 8):.3f},{rng.uniform(-1, 1):.3f}"
    return f"tilt={np.radians(rng.uniform(-0.3, 0.3)):.5f},{sign * np.radians(rng.uniform(1.5, 3)):.5f}"


@one_blas_thread
def carry_out(laboratory: Laboratory, seed: int) -> Campaign:
    """Simulate, discover, propose and simulate until one explanation is left or the budget ends.

    Args:
        laboratory: with the effect in question as the first that is hidden.
    """
    robot, hidden = laboratory.robot, laboratory.hidden[0]
    pool = plan = shipped_plan(robot, PLACEMENTS)
    experiment, expected, every = Experiment(SESSION), [], []
    verdicts, words = [], ["first experiment"]
    try:
        while True:
            inside = laboratory.manipulated(*experiment.manipulations, session=SESSION)
            noise = int(np.random.SeedSequence([seed, len(every) + 1]).generate_state(1)[0])
            every.append(inside.run(plan, noise, "statics", workers=1).measurements)
            found = discover_effects(joined(every), robot, seed, check=False)
            verdicts.append(found.verdict)
            if found.verdict != AMBIGUOUS or len(every) == EXPERIMENTS:
                break
            best = found.propose(pool, seed).best
            plan, experiment = best.plan, best.experiment
            expected.append(best.entropy_expected)
            words.append(", ".join(experiment.manipulations) or "more postures")
    except InputError as error:
        return Campaign(str(hidden), failed=str(error))
    adopted = found.adopted
    errors = []
    for effects in ((), adopted):
        full = identify(joined(every[:1]), robot, estimator=MIXED_MODEL, adopted=effects).full
        off = (full.value - laboratory.true_base_parameters(pool)) / standard_errors(full.covariance)
        errors.append(float(np.sqrt((off**2).mean())))
    return Campaign(
        hidden=str(hidden),
        verdicts=tuple(verdicts),
        words=tuple(words),
        expected=expected[0] if expected else None,
        right=found.verdict == NAMED and [one.label for one in adopted] == [hidden.label],
        errors=(errors[0], errors[1]),
    )

"""Rank the experiments that would settle between explanations, by what they settle a minute."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.base.result import InMemory
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.calibration.calibration_result import SelfCalibration
from tulip_testbed.calibration.self_calibration import self_calibrate
from tulip_testbed.discovery.discover import AMBIGUOUS
from tulip_testbed.discovery.experiment_information import (
    Explanation,
    JointInformation,
    entropy,
    expected_entropy,
    joint_information,
    probabilities,
    separations,
)
from tulip_testbed.discovery.nominal_laboratory import exact_rig, measured_plan, simulated
from tulip_testbed.effects.instance import EffectInstance, injected
from tulip_testbed.effects.lasting import FROM, epochs, everywhere
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.measurements import Experiment, Measurements, PosturePlan, joined
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.measurements.joined import separate
from tulip_testbed.measurements.manipulations import (
    EXCHANGED,
    MOVED,
    ROBOT_TURNED,
    TARED,
    UNTIED,
    KnownMass,
    needs_cells,
    written_mass,
)
from tulip_testbed.sim.robot import Robot, joint_names, joint_ranges

# Assumed minutes of laboratory time: of a posture, of a placement, and of each manipulation.
POSTURE, PLACEMENT = 1.0, 2.0
MANIPULATION = {
    EXCHANGED: 5.0,
    "plate turned": 3.0,
    ROBOT_TURNED: 5.0,
    UNTIED: 2.0,
    TARED: 3.0,
    MOVED: 10.0,
    "encoder re-zeroed": 10.0,
    "known mass": 5.0,
}
UNCHANGED = "nothing changed, more postures"
ADDED_MASS = 0.1  # of the robot's, at the torso's origin
ENOUGH = 15.0  # ln of the Bayes factor that is expected at least: some 3 are needed, and noise takes up to 11
LEAST, MOST = 6, 30  # placements
FACTORS = np.array([1e3, 1e3, 1.0, 1.0, 1.0])  # from residuals to an expected result


@dataclass(frozen=True)
class Doubt:
    """A gap with several explanations, and the effects that explain the other gaps."""

    explanations: tuple[Explanation, ...]
    others: tuple[EffectInstance, ...] = ()

    @property
    def entropy(self) -> float:
        """Return the entropy of the explanations' posterior [nats]."""
        return float(entropy(probabilities([one.log_bayes_factor for one in self.explanations])))


@dataclass(frozen=True)
class ExpectedResult:
    """The mean residuals of an experiment that an explanation predicts."""

    explanation: str
    cop_x_mm: float
    cop_y_mm: float
    force_N: float  # noqa: N815, as the key has it
    twist_right_N: float  # noqa: N815
    twist_left_N: float  # noqa: N815


@dataclass(frozen=True)
class NextExperiment:
    """An experiment and what it is expected to settle; entropies in nats, separations in ln Bayes factor.

    Attributes:
        placements, postures: how many there are. minutes: of laboratory time, assumed.
        entropy_now, entropy_expected: of the explanations' posterior before and, as expected, afterwards.
        separation: least expected between two explanations, with everything measured so far.
        separation_now: the same without the experiment.
        plan: its postures, some of the placements that were to choose from.
    """

    session: str
    manipulations: tuple[str, ...]
    placements: int
    postures: int
    minutes: float
    entropy_now: float
    entropy_expected: float
    settled_per_minute: float
    separation: float
    separation_now: float
    predictions: tuple[ExpectedResult, ...]
    plan: InMemory[PosturePlan]

    @property
    def experiment(self) -> Experiment:
        """Return its session and manipulations."""
        return Experiment(self.session, self.manipulations)

    @property
    def settled(self) -> float:
        """Return the share of the doubt that is expected to be settled."""
        return settled(self.entropy_now, self.entropy_expected) / max(self.entropy_now, 1e-12)

    @property
    def words(self) -> str:
        """Describe the manipulations."""
        return ", ".join(self.manipulations) or UNCHANGED


def settled(now: float, expected: float) -> float:
    """Return the expected decrease of an entropy [nats]."""
    return max(now - expected, 0.0)


@dataclass(frozen=True)
class Pool:
    """Postures to choose from, and what the nominal laboratory would read if the best explanations hold."""

    plan: PosturePlan
    readings: Measurements


@one_blas_thread
def rank_experiments(
    measurements: Measurements,
    robot: Robot,
    doubts: Sequence[Doubt],
    plan: PosturePlan | None = None,
    seed: int = 0,
) -> list[NextExperiment]:
    """Rank experiments by the entropy that they are expected to settle a minute, the best first.

    Args:
        measurements: everything so far.
        doubts: what is to be settled.
        plan: postures to choose from; None: those that were measured.
        seed: of the draws of the expectation.

    Raises:
        InputError: nothing to settle; explanations with which no calibration converges.
    """
    if not doubts:
        raise InputError("explanations: found no gap with several explanations, expected one to settle")
    try:
        now, pool, calibration = _state(measurements, robot, doubts, plan)
        ranking = []
        for manipulations in possible(now.measurements, robot, doubts):
            experiment = Experiment(session_of(now.measurements), manipulations)
            prospect = Prospect.of(now, pool, calibration, doubts, experiment)
            ranking.append(prospect.chosen(prospect.best_placements(), seed))
    except np.linalg.LinAlgError:
        raise InputError(
            "explanations: found some with which no calibration converges; expected a smaller fault"
        ) from None
    return sorted(ranking, key=lambda experiment: -experiment.settled_per_minute)


def _state(
    measurements: Measurements, robot: Robot, doubts: Sequence[Doubt], plan: PosturePlan | None
) -> tuple[Observation, Pool, SelfCalibration]:
    """Return what was measured, the postures to choose from, and the calibration with the best effects."""
    now = observe(measurements, nominal_robot(robot, common_support(measurements.support)))
    best = [_most_probable(doubt.explanations).instance for doubt in doubts]
    effects = {effect.label: effect for effect in (*best, *doubts[0].others)}
    calibration = self_calibrate(now, None, [replace(effect, intervals=()) for effect in effects.values()])
    lasting = [effect for effect in effects.values() if everywhere(effect.target)]
    return now, pool_of(now, plan, lasting), calibration


def pool_of(now: Observation, plan: PosturePlan | None, effects: Sequence[EffectInstance]) -> Pool:
    """Simulate the postures to choose from: of a plan, or those that were measured first.

    Args:
        effects: the best explanations. Columns of large ones differ between readings with and without them.

    Raises:
        InputError: none of them has an equilibrium.
    """
    m = now.measurements
    if plan is None:
        first = np.flatnonzero(m.of_experiment == 0)
        kept = first[np.unique(m.posture[first], return_index=True)[1]]
        plan = within_limits(measured_plan(now.take(np.sort(kept))), now.nominal.robot)
    readings = simulated(injected(exact_rig(now), effects), plan)
    plan = plan.take(np.isin(plan.posture, readings.posture))
    return Pool(plan, readings)


def within_limits(plan: PosturePlan, robot: Robot) -> PosturePlan:
    """Return a plan with every angle inside its joint's range.

    Measured angles may leave it by the encoders' errors, and a plan that does is refused.
    """
    names, ranges = joint_names(robot.model), joint_ranges(robot.model)
    low, high = ranges[[names.index(joint) for joint in plan.joints]].T
    return replace(plan, joint_angles=plan.joint_angles.clip(low, high))


def session_of(m: Measurements) -> str:
    """Return the session of the last experiment."""
    return m.experiments[-1].session if m.experiments else ""


def possible(m: Measurements, robot: Robot, doubts: Sequence[Doubt]) -> list[tuple[str, ...]]:
    """List the manipulations, each by itself, that may tell something about the doubts."""
    every = [one.instance for doubt in doubts for one in doubt.explanations]
    names = {one.effect.name for one in every}
    cells = m.contacts is None
    single = [EXCHANGED, *(f"{plate} plate turned by 180 deg" for plate in PLATES), ROBOT_TURNED, UNTIED]
    if "cell-tare" in names:
        single.append(TARED)
    if names & {"plate-translation", "plate-yaw"}:
        single.append(MOVED)
    zeroed = [one.target.partition(FROM)[0] for one in every if one.effect.name == "encoder-offset"]
    single += [f"encoder re-zeroed: {joint}" for joint in dict.fromkeys(zeroed)]
    mass = round(ADDED_MASS * float(robot.model.body_mass.sum()), 1)
    single.append(written_mass(KnownMass(mass, robot.model.body(1).name, (0.0, 0.0, 0.0))))
    return [(), *((text,) for text in single if cells or not needs_cells(text))]


def minutes_of(experiment: Experiment, placements: int, postures: int) -> float:
    """Return the assumed time of an experiment [min]."""
    time = PLACEMENT * placements + POSTURE * postures
    return time + sum(
        next(minutes for words, minutes in MANIPULATION.items() if words in text)
        for text in experiment.manipulations
    )


@dataclass(frozen=True)
class Prospect:
    """One experiment of which the placements are still open."""

    experiment: Experiment
    doubts: tuple[Doubt, ...]
    informations: tuple[JointInformation, ...]
    pool: Pool

    @classmethod
    def of(
        cls,
        now: Observation,
        pool: Pool,
        calibration: SelfCalibration,
        doubts: Sequence[Doubt],
        experiment: Experiment,
    ) -> Self:
        """Compute what every placement of the pool would tell."""
        whole = with_planned(now, pool.readings, experiment)
        new = len(whole.measurements.experiments) - 1
        kept = tuple(_in_joint(doubt, whole.measurements) for doubt in doubts)
        found = tuple(joint_information(whole, d.explanations, d.others, calibration, new) for d in kept)
        return cls(experiment, kept, found, pool)

    def best_placements(self) -> np.ndarray:
        """Choose the fewest placements that are expected to separate all explanations, by index."""
        count = len(self.informations[0].numbers)
        alone = [self.least_separation(np.array([k])) for k in range(count)]
        order, number = np.argsort(-np.array(alone), kind="stable"), LEAST
        while number < min(count, MOST) and self.least_separation(order[:number]) < ENOUGH:
            number += 2
        return np.sort(order[: min(number, count)])

    def least_separation(self, chosen: np.ndarray | None) -> float:
        """Return the least expected ln Bayes factor between two explanations of a gap."""
        every = []
        for doubt, found in zip(self.doubts, self.informations, strict=True):
            apart = separations(doubt.explanations, found.of_explanations(chosen))
            every.append(apart[~np.eye(len(apart), dtype=bool)].min())
        return float(min(every))

    def chosen(self, placements: np.ndarray, seed: int = 0) -> NextExperiment:
        """Return the experiment with some of the placements, by index, and what it is expected to settle."""
        rng, after, predicted = np.random.default_rng(seed), 0.0, []
        for doubt, found in zip(self.doubts, self.informations, strict=True):
            before = found.of_explanations(None)
            after += expected_entropy(doubt.explanations, before, found.of_explanations(placements), rng)
            rows = found.predictions(doubt.explanations, placements)
            predicted += [
                ExpectedResult(one.instance.label, *(FACTORS * row[:5]).tolist())
                for one, row in zip(doubt.explanations, rows, strict=True)
            ]
        readings = self.pool.readings
        numbers = np.unique(readings.placement)[placements]
        postures = readings.posture[np.isin(readings.placement, numbers)]
        plan = self.pool.plan.take(np.isin(self.pool.plan.posture, postures))
        minutes = minutes_of(self.experiment, len(placements), len(plan))
        now = sum(doubt.entropy for doubt in self.doubts)
        return NextExperiment(
            session=self.experiment.session,
            manipulations=self.experiment.manipulations,
            placements=len(np.unique(plan.placement)),
            postures=len(plan),
            minutes=minutes,
            entropy_now=float(now),
            entropy_expected=float(after),
            settled_per_minute=float(settled(now, after) / minutes),
            separation=self.least_separation(placements),
            separation_now=self.least_separation(None),
            predictions=tuple(predicted),
            plan=plan,
        )


def with_planned(now: Observation, readings: Measurements, experiment: Experiment) -> Observation:
    """Return what was measured together with what would be read in a planned experiment.

    Only columns are taken there: the readings are those of an ordinary set-up, on the measured plates.
    """
    m, added = now.measurements, experiment.arrangement.known_mass
    weighed = m.weighed_mass
    planned = replace(
        readings,
        sensors=m.sensors,
        gains=m.gains,
        tolerances=m.tolerances,
        robot=m.robot,
        cells=m.cells,
        top_height=m.top_height,
        gravity=m.gravity,
        contacts=m.contacts,
        constant_joints=m.constant_joints,
        weighed_mass=None if weighed is None else (weighed[0] + added, weighed[1]),
        experiments=(experiment,),
    )
    return observe(joined([*separate(m), planned]), now.nominal)


def _in_joint(doubt: Doubt, m: Measurements) -> Doubt:
    """Return a doubt whose effects act in the experiments in which they were found."""
    return Doubt(
        tuple(replace(one, instance=_first(one.instance, m)) for one in doubt.explanations),
        tuple(_first(one, m) for one in doubt.others),
    )


def _first(one: EffectInstance, m: Measurements) -> EffectInstance:
    found = epochs(one.effect.lasting, one.target.partition(FROM)[0], m.experiments)
    if not everywhere(one.target) or len(set(found)) == 1:
        return replace(one, intervals=())
    return replace(one, target=f"{one.target}{FROM}{found[0]}", intervals=())


def doubts_of(verdict: str, explanations: Sequence[Explanation]) -> list[Doubt]:
    """List the gaps of an ambiguous discovery that have several explanations.

    The best explanations of the other gaps are taken as true.
    """
    if verdict != AMBIGUOUS:
        return []
    gaps: dict[int, list[Explanation]] = {}
    for explanation in explanations:
        gaps.setdefault(explanation.gap, []).append(explanation)
    best = {gap: _most_probable(several).instance for gap, several in gaps.items()}
    return [
        Doubt(tuple(several), tuple(effect for other, effect in best.items() if other != gap))
        for gap, several in gaps.items()
        if len(several) > 1
    ]


def _most_probable(explanations: Sequence[Explanation]) -> Explanation:
    return max(explanations, key=lambda explanation: explanation.log_bayes_factor)

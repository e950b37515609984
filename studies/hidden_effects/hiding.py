"""Draw a laboratory and hide something in it, large enough to be seen there or as large as its prior says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from studies.hidden_effects.outside_faults import FAULTS, Description, Fault
from tulip_testbed.base.errors import InputError
from tulip_testbed.calibration.linear_model import LinearModel
from tulip_testbed.calibration.ordinary_laboratory import ordinary_members
from tulip_testbed.calibration.self_calibration import self_calibrate, usual_tolerances
from tulip_testbed.discovery.candidate_search import calibrated_data
from tulip_testbed.discovery.candidates import Candidate, candidates
from tulip_testbed.discovery.columns import CandidateColumns, candidate_columns
from tulip_testbed.discovery.detectability import noncentrality, single_level
from tulip_testbed.discovery.evidence import DETECTABLE, effective_tests
from tulip_testbed.discovery.refit import simulated, without_noise
from tulip_testbed.discovery.selection import LEVEL
from tulip_testbed.discovery.unusual_members import STANDS_OUT
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.instance import EffectInstance, effect_label, injected
from tulip_testbed.effects.random_effects import draw_of_kind
from tulip_testbed.experiments.atlases.isolability import ISOLABLE
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import residuals
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot

NOTHING, SCATTER, PRIOR, SINGLE = "nothing", "scatter", "prior", "single"
TWO, LEFT_OUT, OUTSIDE = "two", "left out", "outside"
ROBOTS = (0.05, 0.2)  # spread of masses and centres of mass at imperfections 1, see `sim.random_robots`
SCATTERED = (0.5, 3.0)  # times the data sheet's placement_sd
CLEAR = (2.0, 3.0, 4.0)  # multiples of the minimum detectable size
OUTSIDE_MULTIPLES = (4.0, 16.0)
MOST_PRIORS = 8.0  # s.d.: no larger effect is hidden
TRIAL = 0.1  # of a fault's typical amplitude, to measure what it shows
LEAST_SIGNAL = 1e-6  # over the noise


@dataclass(frozen=True)
class Case:
    """One data set to be made.

    Attributes:
        arm: what kind of thing is hidden. kinds: of the effects, or the name of the fault outside.
        multiple: of the minimum detectable size; 0: drawn.
        dynamics: whether it is measured in the full dynamics.
    """

    arm: str
    kinds: tuple[str, ...] = ()
    multiple: float = 0.0
    dynamics: bool = False


@dataclass(frozen=True)
class World:
    """The laboratories that are drawn.

    Attributes:
        imperfections: scale of the ordinary ones and of the spread of the robots; 0: perfect instruments and
            the nominal robot.
    """

    robot: Robot
    plan: PosturePlan
    preset: str
    imperfections: float


@dataclass(frozen=True)
class Trial:
    """A laboratory and what is wrong with it.

    Attributes:
        faults: effects of the catalogue that are hidden, in addition to ordinary imperfections.
        twins: for each of them the labels of what can look like it.
        label, right: of a fault outside the catalogue: its name and the right descriptions.
    """

    laboratory: Laboratory
    faults: tuple[EffectInstance, ...] = ()
    twins: tuple[tuple[str, ...], ...] = ()
    label: str = ""
    right: tuple[Description, ...] = ()


def draw_trial(case: Case, world: World, stream: int, rng: np.random.Generator) -> Trial:
    """Draw a laboratory of the world and hide what the case says.

    Args:
        stream: seed of the experiment, by which the size of what can be seen is found too.

    Raises:
        InputError: the robot falls, or no plausible size can be seen or built.
    """
    robot, rig = world.robot, preset_rig(world.preset, world.robot)
    if case.arm == SCATTER:
        return Trial(Laboratory(robot, world.preset, nominal=_scattered(rig, float(rng.uniform(*SCATTERED)))))
    members: tuple[EffectInstance, ...] = ()
    if world.imperfections:
        spread = world.imperfections * float(rng.uniform(*ROBOTS))
        rig = edited(rig, edit_of(robot.model, draw_robot(robot.model, spread, rng)))
        members = ordinary_members(rig, rng, world.imperfections)
    plain = Laboratory(robot, world.preset, hidden=members, nominal=rig)
    if case.arm == NOTHING:
        return Trial(plain)
    if case.arm == PRIOR:
        places = tuple(int(number) for number in np.unique(world.plan.placement))
        return _with(plain, (draw_of_kind(catalogue()[case.kinds[0]], robot, places, rng),))
    measured = plain.run(world.plan, stream, "statics", workers=1).measurements
    observed = observe(measured, nominal_robot(robot))
    if case.arm == OUTSIDE:
        (fault,) = (one for one in FAULTS if one.name == case.kinds[0])
        return _outside(fault, observed, plain, rig, world.plan, rng)
    tolerances = usual_tolerances(observed, None).value
    clear = _Clear(observed, case.multiple, rng)
    faults: list[EffectInstance] = []
    twins = []
    for kind in case.kinds:
        # A clear effect is no ordinary imperfection.
        usual = tolerances.get(kind, 0.0) * min(world.imperfections, 1.0) * (case.multiple in CLEAR)
        fault, near = clear.draw(kind, STANDS_OUT * usual, {one.label for one in faults})
        faults.append(fault)
        twins.append(near)
    return replace(_with(plain, tuple(faults)), twins=tuple(twins))


def _scattered(rig: Rig, factor: float) -> Rig:
    (px, py, pa), (mx, my, ma) = factor * np.array([rig.sensors.placement_sd, rig.sensors.mark_sd])
    return replace(rig, sensors=replace(rig.sensors, placement_sd=(px, py, pa), mark_sd=(mx, my, ma)))


def _with(plain: Laboratory, faults: tuple[EffectInstance, ...]) -> Trial:
    """Hide effects in a laboratory, each in the place of the ordinary imperfection of its label."""
    labels = {one.label for one in faults}
    kept = (one for one in plain.hidden if one.label not in labels)
    return Trial(replace(plain, hidden=(*kept, *faults)), faults)


class _Clear:
    """Draw effects of multiples of the minimum detectable size of one laboratory.

    That size is found with 90 % probability by a single test at the level of the whole catalogue's.
    """

    def __init__(self, observed: Observation, multiple: float, rng: np.random.Generator) -> None:
        self.multiple, self.rng = multiple, rng
        _, self.columns, self.level = _predictions(observed, rng)
        every = zip(self.columns.candidates, self.columns.projected, strict=True)
        self.bases = [[_visible(candidate, column) for column in each] for candidate, each in every]

    def draw(self, kind: str, beyond: float, taken: set[str]) -> tuple[EffectInstance, tuple[str, ...]]:
        """Draw an effect of a kind, and find the labels of what can look like it.

        Args:
            beyond: of the largest value, what it must exceed to be no ordinary one. taken: labels.

        Raises:
            InputError: no plausible size is clear.
        """
        every = self.columns.candidates
        own = [k for k, one in enumerate(every) if one.effect.name == kind and one.label not in taken]
        for k in self.rng.permutation(own).tolist():
            candidate = every[k]
            point = int(self.rng.integers(len(candidate.settings)))
            column = self.columns.projected[k][point]
            sizes = self._sizes(candidate, column, beyond)
            if sizes is None:
                continue
            near = _angles(column @ sizes if len(sizes) else column[:, 0], every, self.bases)
            twins = (label for label, a in near.items() if a < ISOLABLE and label != candidate.label)
            values = candidate.values(sizes, point)
            return EffectInstance(candidate.effect, candidate.target, values), tuple(twins)
        raise InputError(f"{kind}: no plausible size is clear in this laboratory")

    def _sizes(self, candidate: Candidate, column: np.ndarray, beyond: float) -> np.ndarray | None:
        """Draw the sizes in a random direction; None: they would be implausible."""
        one_sided = candidate.positive.any() or not candidate.effect.sizes
        freedom = max(len(candidate.effect.sizes), 1)
        least = float(np.sqrt(noncentrality(freedom, 2 * self.level if one_sided else self.level)))
        if not candidate.effect.sizes:
            return np.zeros(0) if np.linalg.norm(column) >= self.multiple * least else None
        along = candidate.prior * self.rng.standard_normal(len(candidate.prior))
        along = np.where(candidate.positive, np.abs(along), along)
        length = max(float(np.linalg.norm(column @ along)), 1e-300)
        sizes = along * max(self.multiple * least / length, beyond / float(np.abs(along).max()))
        return sizes if (np.abs(sizes) <= MOST_PRIORS * candidate.prior).all() else None


def _predictions(
    observed: Observation, rng: np.random.Generator
) -> tuple[LinearModel, CandidateColumns, float]:
    """Return what all candidates show in a laboratory, and the level of a single test among them."""
    linear = calibrated_data(observed, self_calibrate(observed)).null.linear
    columns = candidate_columns(linear, candidates(observed))
    return linear, columns, single_level(LEVEL, effective_tests([columns], rng))


def _visible(candidate: Candidate, columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of what a candidate can show within its prior, (r + 1, k)."""
    scaled = columns * candidate.prior if candidate.effect.sizes else columns
    left, size, _ = np.linalg.svd(scaled, full_matrices=False)
    return left[:, size > DETECTABLE]


def _angles(
    signal: np.ndarray, every: Sequence[Candidate], bases: Sequence[Sequence[np.ndarray]]
) -> dict[str, float]:
    """Angle between a signal and what each candidate can show, by label [rad]."""
    length = np.linalg.norm(signal)
    return {
        one.label: min(float(np.arccos(min(1.0, np.linalg.norm(b.T @ signal) / length))) for b in each)
        for one, each in zip(every, bases, strict=True)
    }


def _outside(
    fault: Fault,
    observed: Observation,
    plain: Laboratory,
    rig: Rig,
    plan: PosturePlan,
    rng: np.random.Generator,
) -> Trial:
    """Hide a fault that the catalogue lacks, at a multiple of its minimum detectable size.

    The change by the fault is simulated without noise: a scene that is edited draws other random numbers.

    Args:
        rig: the laboratory without effects.
    """
    number = int(rng.integers(1000))
    linear, _, level = _predictions(observed, rng)
    trial = TRIAL * fault.amplitude
    without, within = (
        observe(_quiet(injected(one, plain.hidden), plan, observed.measurements), observed.nominal)
        for one in (rig, fault.inject(rig, number, trial))
    )
    change = residuals(within, linear.theta) - residuals(without, linear.theta)
    length = float(np.linalg.norm(linear.project(linear.whitening(change[..., None]))))
    if length < LEAST_SIGNAL:
        raise InputError(f"{fault.name}: shows nothing in this laboratory")
    size = trial * float(np.sqrt(noncentrality(1, level))) / length
    size *= float(np.exp(rng.uniform(*np.log(OUTSIDE_MULTIPLES))))
    size *= 1.0 if fault.positive else float(rng.choice([-1.0, 1.0]))
    return Trial(
        replace(plain, nominal=fault.inject(rig, number, size)),
        label=f"{effect_label(fault.name, str(number))}={size:.3g}",
        right=fault.right(plain.robot, number),
    )


def _quiet(rig: Rig, plan: PosturePlan, measured: Measurements) -> Measurements:
    """Return the rows that were measured without noise; those of a repeated posture are alike."""
    found = simulated(without_noise(rig), plan)
    if missing := set(measured.posture.tolist()) - set(found.posture.tolist()):
        raise InputError(f"without noise the robot falls in postures {sorted(missing)}")
    rows = {posture: row for row, posture in enumerate(found.posture.tolist())}
    aligned = found.take(np.array([rows[posture] for posture in measured.posture.tolist()]))
    return replace(aligned, sensors=measured.sensors)

"""One case carried out: a data set in which something is hidden, and what is found in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2, ncx2

from tulip_testbed.base.errors import InputError
from tulip_testbed.discovery.detectability import noncentrality
from tulip_testbed.discovery.discover import Discovery, discover
from tulip_testbed.discovery.refit import without_noise
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance, effect_label, injected
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.experiments.benchmark import cases as arms
from tulip_testbed.experiments.benchmark.case_outcome import Bias, Outcome
from tulip_testbed.experiments.benchmark.cases import Case
from tulip_testbed.experiments.benchmark.draw import Hidden, draw_absorbed, draw_visible
from tulip_testbed.experiments.benchmark.judged import calibrated_members, covered, found_effects
from tulip_testbed.experiments.benchmark.outside_faults import OUTSIDE
from tulip_testbed.experiments.benchmark.scoreboard import Board
from tulip_testbed.experiments.identify import identify
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.estimators import DEFAULT
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.random_robots import draw_robot
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.statics.solved_plan import SolvedPlan, solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

LEAST_STANDING = 0.75  # of a plan's postures: a laboratory in which more fall would not go on
SPREAD = 0.1  # of random true robots, see `sim.random_robots`


@dataclass(frozen=True)
class Trial:
    """The laboratory of a case and what is known of it.

    Attributes:
        standard: of the true robot, (1, n_links, 4); None: the nominal one.
    """

    rig: Rig
    hidden: tuple[Hidden, ...]
    label: str
    twins: tuple[tuple[str, ...], ...]
    multiple: float
    remainder: float = 0.0
    standard: np.ndarray | None = None


def carry_out(case: Case, run: int, seed: int, board: Board) -> Outcome:
    """Draw what a case leaves open, measure, discover, compare with the truth.

    Args:
        run: number of the case: its random streams depend on it and `seed` alone.
    """
    drawing, laboratory, discovering = np.random.SeedSequence(seed, spawn_key=(1, run)).spawn(3)
    trial = _trial(case, np.random.default_rng(drawing), board)
    known = Outcome(
        run=run,
        arm=case.arm,
        kinds=case.kinds,
        multiple=trial.multiple,
        dynamics=case.dynamics,
        hidden=tuple(h.label for h in trial.hidden) or ((trial.label,) if trial.label else ()),
        values=tuple(h.instance.values for h in trial.hidden),
        predicted=_predicted(trial, board),
        twins=trial.twins,
        remainder=trial.remainder,
    )
    try:
        measured = _measured(trial, case, laboratory, board)
        if len(np.unique(measured.posture)) < LEAST_STANDING * len(board.plan.posture):
            return replace(known, failed=f"only {len(measured)} of {len(board.plan.posture)} postures stand")
    except InputError as error:
        return replace(known, failed=str(error))
    effects = dict(catalogue())
    if case.arm == arms.LEFT_OUT:
        effects = {k: v for k, v in effects.items() if k not in case.kinds}
    try:
        found = discover(
            measured,
            board.rig.robot,
            int(discovering.generate_state(1)[0]),
            effects,
            hold_out=case.arm == arms.SINGLE,
        )
    except InputError:
        return replace(known, rows=len(measured), verdict="refused")
    return replace(known, rows=len(measured), **_judged(known, trial, found, case, board))


def _trial(case: Case, rng: np.random.Generator, board: Board) -> Trial:
    if case.arm == arms.ROBOTS:
        robot = draw_robot(board.rig.robot.model, SPREAD, rng)
        return Trial(board.rig, (), "", (), 0.0, standard=robot[None])
    if case.arm == arms.OUTSIDE_ARM:
        return _outside(case, rng, board)
    if case.arm == arms.ABSORBED:
        hidden = [draw_absorbed(board, kind, rng) for kind in case.kinds]
    else:
        hidden = [draw_visible(board, kind, case.multiple, rng) for kind in case.kinds]
    own = [case.kinds if case.arm == arms.LEFT_OUT else [h.label] for h in hidden]
    twins = tuple(board.twins(h.signal, o) if h.multiple else () for h, o in zip(hidden, own, strict=True))
    rig = injected(board.rig, [h.instance for h in hidden])
    multiple = min((h.multiple for h in hidden), default=0.0)
    remainder = board.remainder(hidden[0].signal, own[0]) if len(hidden) == 1 and multiple else 0.0
    return Trial(rig, tuple(hidden), "", twins, multiple, remainder)


def _outside(case: Case, rng: np.random.Generator, board: Board) -> Trial:
    """Return a fault whose signal is so many times as long as one effect of one size must be to be found."""
    (fault,) = [o for o in OUTSIDE if o.name == case.kinds[0]]
    number, sign = int(rng.integers(1000)), float(rng.choice([-1.0, 1.0]))
    signal = board.signal(lambda rig: fault.inject(rig, number, fault.amplitude))
    wanted = case.multiple * float(np.sqrt(noncentrality(1, board.level)))
    size = sign * fault.amplitude * wanted / float(np.linalg.norm(signal))
    size = abs(size) if fault.positive else size
    label = f"{effect_label(fault.name, str(number))}={size:.3g}"
    signal = signal * (size / fault.amplitude)
    return Trial(
        fault.inject(board.rig, number, size),
        (),
        label,
        (board.twins(signal),),
        case.multiple,
        board.remainder(signal),
    )


def _predicted(trial: Trial, board: Board) -> float:
    """Power with which a single effect of this length of signal exceeds the catalogue's level."""
    if len(trial.hidden) != 1 or not trial.multiple:
        return 0.0
    hidden, freedom = trial.hidden[0], max(len(trial.hidden[0].instance.effect.sizes), 1)
    effect = hidden.instance.effect
    one_sided = not effect.sizes or any(effect.parameters[k].positive for k in effect.sizes)
    bound = chi2.isf(2 * board.level if one_sided else board.level, freedom)
    return float(ncx2.sf(bound, freedom, float(hidden.signal @ hidden.signal)))


def _measured(trial: Trial, case: Case, stream: np.random.SeedSequence, board: Board) -> Measurements:
    if case.dynamics:
        return run_dynamics(trial.rig, board.plan, int(stream.generate_state(1)[0])).measurements
    return run_statics(_prepared(trial.rig, board.solved_plan), [stream], trial.standard)[0].measurements


def _prepared(rig: Rig, plain: SolvedPlan) -> SolvedPlan:
    """Instruments that misread change no equilibrium of the plain laboratory."""
    if replace(rig, misread=None) == plain.rig:
        return replace(plain, rig=rig)
    return solve_plan(rig, plain.plan)


def _judged(
    known: Outcome,
    trial: Trial,
    found: Discovery,
    case: Case,
    board: Board,
) -> dict[str, Any]:
    listed = [u for u in found.undetectable if u.candidate.label in known.hidden]
    held = found.heldout
    biased = case.arm == arms.SINGLE and not case.dynamics and trial.multiple >= 1
    return {
        "verdict": found.verdict,
        "found": found_effects(found),
        "calibrated": calibrated_members(found),
        "unseen": bool(listed),
        "biased": listed[0].parameter if listed else 0,
        "held": held and (held.before["AFTC"], held.after["AFTC"], held.floor["AFTC"]),
        "coverage": tuple(c for h in trial.hidden for c in covered(found, h.instance, of_time=False)),
        "times": tuple(c for h in trial.hidden for c in covered(found, h.instance, of_time=True)),
        "bias": _bias(found, trial, board) if biased else None,
        "wall_s": found.wall_s,
    }


def _bias(found: Discovery, trial: Trial, board: Board) -> Bias:
    """Of the base parameters, by readings without noise of the laboratory with and without the effect."""
    robot, measured = board.rig.robot, _without_noise(trial.rig, board)
    plain = identify(_without_noise(board.rig, board), robot, estimator=DEFAULT).full
    error = plain.value - _truth(board.rig, board)
    noisy = identify(board.linear.observed.measurements, robot, estimator=DEFAULT).full
    spread = np.sqrt(np.diag(noisy.clustered_covariance))

    def bias(adopted: Sequence[EffectInstance]) -> np.ndarray:
        estimate = identify(measured, robot, estimator=DEFAULT, adopted=adopted).full
        return (estimate.value - _truth(trial.rig, board) - error) / spread

    before, after = bias(()), bias(found.adopted)
    return Bias(
        largest=float(np.abs(before).max()),
        before=float(np.sqrt((before**2).mean())),
        after=float(np.sqrt((after**2).mean())),
    )


def _truth(rig: Rig, board: Board) -> np.ndarray:
    return true_base_parameters(rig, common_support(board.plan.support))


def _without_noise(rig: Rig, board: Board) -> Measurements:
    """Return readings without noise, with the data sheets of the sensors that have it."""
    measured = run_statics(
        _prepared(without_noise(rig), board.quiet), [np.random.SeedSequence(0)], all_solved=True
    )[0].measurements
    return replace(measured, sensors=header_of(board.rig).sensors)

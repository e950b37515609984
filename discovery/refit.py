"""Refit effects through the static laboratory, and find those that are as good there.

The prediction of an effect is a formula, the laboratory a mechanism: with one compliant joint the whole robot
sinks and shifts its load. The difference is simulated for the measured postures with exact sensors and added
to the prediction.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.discovery.candidate_search import DECISIVE
from tulip_testbed.discovery.candidates import Fitted
from tulip_testbed.discovery.joint_fit import JointFit, joint_fit, remove_terms
from tulip_testbed.effects.instance import injected, removed
from tulip_testbed.effects.lasting import acting
from tulip_testbed.identification.ballast import known_weight
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import ROWS, SIZE, residuals, swing_pose
from tulip_testbed.measurements import Experiment, Measurements, PosturePlan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.sensors import ANKLE, PLATE, PRESETS, WrenchSensors
from tulip_testbed.sim.statics.read_mechanism import read_mechanism
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

ROUNDS = 3
LEAST_STEP = 1e-4  # prior s.d., from which a change of the model error with the sizes is learnt
CLOSE = 0.1  # posterior s.d.: a smaller change of the sizes ends the refit
SHARED = 0.5  # of the change that the laboratory makes in a size: s.d. of the error that it shares
NEAR = 10.0  # ln of the Bayes factor by predictions, within which alternatives are fitted
MOST_REFITS = 4  # alternatives of one term that are fitted through the laboratory
STREAM = 0  # of friction and swaying: the same with and without the effect


def exact_rig(observed: Observation) -> Rig:
    """Return the nominal laboratory of an experiment, with nothing random but friction."""
    rig = without_noise(preset_rig("ideal", observed.nominal.robot))
    if (contacts := observed.measurements.contacts) is None:
        return rig
    wrench = WrenchSensors(place=PLATE if contacts.mount == "ground" else ANKLE, channels=contacts.channels)
    return replace(rig, sensors=replace(rig.sensors, wrench=wrench))


def without_noise(rig: Rig) -> Rig:
    """Return a laboratory with nothing random but friction, and without repeats."""
    return replace(
        rig,
        sensors=PRESETS["ideal"],
        controller=replace(rig.controller, command_sd=0.0),
        protocol=replace(rig.protocol, plate_sd=(0.0, 0.0, 0.0), repeats=0),
    )


def measured_plan(observed: Observation) -> PosturePlan:
    """Return the measured postures as a plan, one per row, with the torques that their commands exert there.

    The swing foot of each stance stands where the angles of its first posture put it. A command cannot tell
    that, because it contains the plan's feed-forward.
    """
    m = observed.measurements
    gain = read_mechanism(exact_rig(observed)).gain
    pose, rows = swing_pose(observed)[:, [0, 1, 5]], observed.geometry.on_swing_foot
    pose[rows] = observed.nominal.other_sole(observed.joint_angles, m.support)[rows]
    first = np.array([np.flatnonzero(observed.stance == number)[0] for number in observed.stance])
    return PosturePlan(
        joints=m.joints,
        joint_angles=observed.joint_angles,
        posture=np.arange(1, len(m) + 1),
        placement=observed.stance + 1,
        support=m.support,
        swing_pose=pose[first],
        robot={"model": m.robot["model"] or "", "sha256": m.robot["sha256"] or ""},
        torques=None if m.command is None else gain * (m.command - observed.joint_angles),
    )


def simulated(rig: Rig, plan: PosturePlan) -> Measurements:
    """Simulate a plan in a laboratory; every posture that has an equilibrium is measured."""
    run = run_statics(solve_plan(rig, plan), [np.random.SeedSequence(STREAM)], all_solved=True)[0]
    return run.measurements


def residuals_left(observed: Observation, rig: Rig, terms: Sequence[Fitted]) -> np.ndarray:
    """Simulate the residuals that are left when the terms are removed as predicted, (m, 11).

    They are zero where the posture has no equilibrium with the terms.
    """
    out = np.zeros((len(observed), 11))
    for part, own, rows in ordinary_parts(observed, terms):
        if own:
            out[rows] = _left(part, rig, own)
    return out


def ordinary_parts(
    observed: Observation, terms: Sequence[Fitted]
) -> Iterator[tuple[Observation, list[Fitted], np.ndarray]]:
    """Yield every experiment that was joined as one in an ordinary laboratory, without its known masses.

    Yields:
        its observation, the terms as they act there, and the numbers of its rows.
    """
    m = observed.measurements
    if not m.experiments:
        yield observed, list(terms), np.arange(len(observed))
        return
    for k in np.unique(m.of_experiment).tolist():
        rows = np.flatnonzero(m.of_experiment == k)
        own = [one for term in terms if (one := _as_there(term, m.experiments, k)) is not None]
        part = observed.take(rows)
        plain = replace(part.measurements, experiments=(), experiment=None)
        yield replace(part, measurements=plain, lift=part.lift - known_weight(part.measurements)), own, rows


def _as_there(term: Fitted, experiments: tuple[Experiment, ...], number: int) -> Fitted | None:
    """Return a term as it acts in one of several experiments; None: it does not."""
    effect = term.candidate.effect
    act = acting(effect, term.candidate.target, term.values, experiments, number)
    if act is None:
        return None
    target, values = act
    there = replace(term.candidate, target=target, settings=np.array([values]))
    return replace(term, candidate=there, point=0, sizes=np.array([values[k] for k in effect.sizes]))


def _left(observed: Observation, rig: Rig, terms: Sequence[Fitted]) -> np.ndarray:
    """Return what `residuals_left` does for one experiment in an ordinary laboratory, (m, 11)."""
    instances = [term.instance for term in terms]
    theta = observed.nominal.value
    # The feet stand where the links put them, not where encoders with errors say.
    plan = measured_plan(remove_terms(observed, observed, terms))
    with_terms, without = (
        observe(simulated(one, plan), observed.nominal) for one in (injected(rig, instances), rig)
    )
    # The terms are removed as from the experiment, with the stiffness of joints that yield.
    clean = removed(replace(with_terms, servo_stiffness=observed.servo_stiffness), instances)
    out = np.zeros((len(observed), 11))
    after, before = residuals(clean, theta), residuals(without, theta)
    rows = {int(number): k for k, number in enumerate(without.measurements.posture)}
    for k, number in enumerate(with_terms.measurements.posture):
        if (at := rows.get(int(number))) is None:
            continue
        change = after[k] - before[at]
        change[ROWS["T"]] *= with_terms.on_four_cells[k] & without.on_four_cells[at]
        out[int(number) - 1] = change
    return out


def refit(found: JointFit) -> JointFit:
    """Fit the sizes again through the static laboratory.

    Returns:
        the fit as it is where the laboratory cannot simulate the terms or adds nothing to their predictions.
    """
    data, rig = found.data, exact_rig(found.data.observed)
    acting_terms = [one for _, own, _ in ordinary_parts(data.observed, found.terms) for one in own]
    changed = injected(rig, [term.instance for term in acting_terms])
    misread_only = replace(changed, misread=None) == rig
    known = all(term.candidate.effect.statics for term in found.terms)
    # Predictions undo misreadings exactly. The times of the simulation are not those of the experiment.
    if misread_only or not known or changed.later is not None:
        return found
    before, formula = np.zeros(len(found.sizes)), found
    model_error = np.zeros((len(data.observed), SIZE, len(before) + 1))
    try:
        for _ in range(ROUNDS):
            sizes = found.sizes
            left = residuals_left(data.observed, rig, found.terms)
            model_error = _updated(model_error, left, sizes, before, found.prior)
            before, found = sizes, joint_fit(data, found.terms, model_error)
            if (np.abs(found.sizes - sizes) < CLOSE * np.sqrt(np.diag(found.covariance))).all():
                break
    except InputError:
        return formula
    return found


def _updated(
    model_error: np.ndarray, left: np.ndarray, sizes: np.ndarray, before: np.ndarray, prior: np.ndarray
) -> np.ndarray:
    """Update the model error so that it holds at these sizes and changes least elsewhere (Broyden 1965).

    Args:
        model_error: as learnt so far, (m, 11, s + 1).
        left: residuals that are left at these sizes, (m, 11).
        sizes, before: now and in the last round, (s,). Without the effect the model error is zero.
    """
    step = (sizes - before) / prior
    out = model_error.copy()
    off = left - model_error @ np.append(sizes, 1.0)
    if step @ step > LEAST_STEP**2:
        out[..., :-1] += off[..., None] * (step / prior) / (step @ step)
    out[..., -1] += left - out @ np.append(sizes, 1.0)
    return out


def equivalent(alternatives: tuple[Fitted, ...], adopted: Fitted) -> tuple[Fitted, ...]:
    """Return the alternatives within `DECISIVE` of the best, and the adopted one in any case.

    Args:
        alternatives: the best first.
    """
    least = alternatives[0].log_bayes_factor - DECISIVE
    return tuple(a for a in alternatives if a.log_bayes_factor > least or a.label == adopted.label)


def stands_alone(term: Fitted) -> bool:
    """Return whether an effect is of the whole laboratory, as the only member of its family is.

    With an alternative in its place it would stay in that family, and explain the readings from there: it is
    compared with alternatives by the joint fit alone.
    """
    return not term.candidate.target


def refit_with_alternatives(
    found: JointFit, alternatives: tuple[tuple[Fitted, ...], ...]
) -> tuple[JointFit, np.ndarray, tuple[tuple[Fitted, ...], ...]]:
    """Fit again through the laboratory, with the alternative of each term that is best there.

    Args:
        alternatives: of each term, see `Selection`; the laboratory corrects their evidence.

    Returns:
        the fit, the s.d. of the error that laboratory and predictions share, (s,), and the equivalent
        explanations of each term.
    """
    best, shared = refit_if_better(found.repeated)
    gained = best.log_evidence - found.repeated.log_evidence
    sets = []
    for k, near in enumerate(alternatives):
        mine, of_mine = best.terms[k], gained
        others = best.without(k)
        rest = (refit_if_better(others)[0] if others.terms else others).log_evidence
        most = best.log_evidence - rest
        judged = [replace(mine, log_bayes_factor=most)]
        base = most - gained - next(one.log_bayes_factor for one in near if one.label == mine.label)
        for alternative, formula in _in_place_of(best, k, near):
            asked = len(judged) <= MOST_REFITS
            exact, doubt = refit_if_better(formula) if asked else (formula, shared)
            # The laboratory corrects no misreading: with any of them, it corrects the other terms alike.
            both_misread = mine.candidate.effect.misreads and alternative.candidate.effect.misreads
            more = of_mine if both_misread else exact.log_evidence - formula.log_evidence
            of_fit = exact.log_evidence - rest
            value = of_fit if stands_alone(mine) else base + alternative.log_bayes_factor + more
            judged.append(replace(alternative, log_bayes_factor=value))
            if asked and judged[-1].log_bayes_factor > most:
                best, shared, most, gained = exact, doubt, judged[-1].log_bayes_factor, more
        judged.sort(key=lambda one: -one.log_bayes_factor)
        sets.append(equivalent(tuple(judged), best.terms[k]))
    return best, shared, tuple(sets)


def refit_if_better(formula: JointFit) -> tuple[JointFit, np.ndarray]:
    """Fit through the laboratory, unless the prediction explains more.

    At which end of its free play a joint rests, for example, is an accident in both. Half of the change that
    the laboratory makes in a size counts as a standard deviation of the error that both share, unless its fit
    is decisively worse: that one has lost its way, and its sizes say nothing.
    """
    exact = refit(formula)
    if exact.log_evidence < formula.log_evidence - DECISIVE:
        return formula, np.zeros(len(formula.sizes))
    shared = SHARED * np.abs(exact.sizes - formula.sizes)
    best = exact if exact.log_evidence >= formula.log_evidence else formula
    return replace(best, covariance=best.covariance + np.diag(shared**2)), shared


def _in_place_of(found: JointFit, k: int, alternatives: tuple[Fitted, ...]) -> list[tuple[Fitted, JointFit]]:
    """Fit the near alternatives of term k in its place, the best first."""
    least = alternatives[0].log_bayes_factor - NEAR
    near = [a for a in alternatives if a.log_bayes_factor > least and a.label not in found.labels]
    tried = [(a, joint_fit(found.data, (*found.terms[:k], a, *found.terms[k + 1 :]))) for a in near]
    return sorted(tried, key=lambda pair: -pair[1].log_evidence)

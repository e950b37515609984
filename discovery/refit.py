"""The virtual laboratory asked about an effect: what its prediction misses there.

An effect's prediction is a formula, the laboratory a mechanism: a hinge on a spring lets the whole robot
sink and shift its load. The difference is simulated for the measured postures, with sensors that err
in nothing, and added to the prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tulip_testbed.discovery.fit import Fit, Term, fit
from tulip_testbed.discovery.fit import removed as without_terms
from tulip_testbed.effects.instance import injected, removed
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_channels import ROWS, residuals, swing_pose
from tulip_testbed.identification.residual_noise import Noise
from tulip_testbed.sim.errors import InputError
from tulip_testbed.sim.measurements import Measurements, PosturePlan
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.sensors import PRESETS
from tulip_testbed.sim.statics import mechanism
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

ROUNDS = 3
LEAST_STEP = 1e-4  # prior s.d., from which a difference of what is missed is worth something
CLOSE = 0.1  # posterior s.d.: a smaller change of the sizes ends the refit
STREAM = 0  # of friction and swaying: the same with and without the effect


def exact_rig(observed: Observation) -> Rig:
    """The nominal laboratory of an experiment, with nothing random but friction."""
    return without_noise(preset_rig("ideal", observed.nominal.robot))


def without_noise(rig: Rig) -> Rig:
    """A laboratory with nothing random but friction, and no repeats."""
    return replace(
        rig,
        sensors=PRESETS["ideal"],
        controller=replace(rig.controller, command_sd=0.0),
        protocol=replace(rig.protocol, plate_sd=(0.0, 0.0, 0.0), repeats=0),
    )


def measured_plan(observed: Observation) -> PosturePlan:
    """The postures as they were measured, one a row, with the torques that their commands exert there.

    A command holds the plan's feed-forward, which by itself says nothing of where the foot was put.
    """
    m = observed.measurements
    gain = mechanism(exact_rig(observed)).gain
    pose = swing_pose(observed)[:, [0, 1, 5]]
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
    """What a rig shows of a plan, every posture that has an equilibrium."""
    return run_statics(solve_plan(rig, plan), [np.random.SeedSequence(STREAM)], all_solved=True)[
        0
    ].measurements


def missed(observed: Observation, rig: Rig, terms: Sequence[Term]) -> np.ndarray:
    """Residuals that the laboratory keeps when the terms' predictions are taken away, (m, 11).

    Zero where the posture has no equilibrium with them.
    """
    theta = observed.nominal.value
    there = [term.instance for term in terms]
    # Feet stand where the links put them, not where encoders that err say.
    plan = measured_plan(without_terms(observed, observed, terms))
    shown, without = (observe(simulated(one, plan), observed.nominal) for one in (injected(rig, there), rig))
    clean = removed(shown, there)
    out = np.zeros((len(observed), 11))
    after, before = residuals(clean, theta), residuals(without, theta)
    rows = {int(number): k for k, number in enumerate(without.measurements.posture)}
    for k, number in enumerate(shown.measurements.posture):
        if (at := rows.get(int(number))) is None:
            continue
        change = after[k] - before[at]
        change[ROWS["T"]] *= shown.on_four_cells[k] & without.on_four_cells[at]
        out[int(number) - 1] = change
    return out


def refit(observed: Observation, noise: Noise, found: Fit) -> tuple[Fit, np.ndarray]:
    """Fit the sizes anew through the laboratory.

    Returns:
        the fit, and what the predictions miss by size and beside it, (m, 11, s + 1).
    """
    rig = exact_rig(observed)
    s = sum(len(term.sizes) for term in found.terms)
    bend = np.zeros((len(observed), 11, s + 1))
    changed = injected(rig, [term.instance for term in found.terms])
    misread_only = replace(changed, misread=None) == rig
    known = all(term.candidate.effect.statics for term in found.terms)
    # What instruments make of readings, predictions undo exactly; times are not those of the simulation.
    if misread_only or not known or changed.later is not None:
        return found, bend
    prior = np.concatenate([term.candidate.prior for term in found.terms])
    before, formula = np.zeros(s), found
    try:
        for _ in range(ROUNDS):
            sizes = np.concatenate([term.sizes for term in found.terms])
            left = missed(observed, rig, found.terms)
            bend = _learnt(bend, left, sizes, before, prior)
            before, found = sizes, fit(observed, noise, found.terms, bend)
            change = np.concatenate([term.sizes for term in found.terms]) - sizes
            if (np.abs(change) < CLOSE * np.sqrt(np.diag(found.covariance))).all():
                break
    except InputError:
        return formula, np.zeros_like(bend)
    return found, bend


def _learnt(
    bend: np.ndarray, left: np.ndarray, sizes: np.ndarray, before: np.ndarray, prior: np.ndarray
) -> np.ndarray:
    """What is missed by size, so that it is right here and changed least elsewhere (Broyden 1965).

    Args:
        bend: as learnt so far, (m, 11, s + 1). left: what is missed at these sizes, (m, 11).
        before: the last sizes, (s,); what is missed without the effect is nothing.
    """
    step = (sizes - before) / prior
    out = bend.copy()
    off = left - bend @ np.append(sizes, 1.0)
    if step @ step > LEAST_STEP**2:
        out[..., :-1] += off[..., None] * (step / prior) / (step @ step)
    out[..., -1] += left - out @ np.append(sizes, 1.0)
    return out

"""Parts with free play: how they are found among other candidates, and what they hide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tulip_testbed.calibration.linear_model import LinearModel
from tulip_testbed.discovery.candidates import Candidate, Fitted
from tulip_testbed.discovery.columns import candidate_blocks
from tulip_testbed.discovery.evidence import ranked
from tulip_testbed.effects.laws.grammar import ENCODER
from tulip_testbed.identification.observation import Observation

PLAUSIBLE = (0.25, 0.5, 1.0, 2.0)  # times the plausible size, at which loose parts are ranked


def loosest(linear: LinearModel, candidates: Sequence[Candidate]) -> list[Fitted]:
    """Return the loose part that explains most at a plausible size; none of a robot that moves.

    Columns are taken at size zero, where a part rests at one end by whichever sign its load has. With much
    play it rests anywhere while it bears no load, and only the scatter of the residuals shows it. Its Bayes
    factor counts that scatter, which those of other candidates do not.
    """
    loose = {one.label: one for one in candidates if one.effect.sizes and one.effect.mechanism.unsure}
    if not loose or linear.observed.moves:  # for the noise of each row by itself a motion has too many
        return []
    at_sizes = [one.at_sizes(PLAUSIBLE) for one in loose.values()]
    best = ranked(candidate_blocks(linear, at_sizes), linear.residual)[0]
    one = loose[best.label]
    return [replace(best, candidate=one, point=0, sizes=np.array(best.values)[[*one.effect.sizes]])]


def hidden_joints(observed: Observation, terms: Sequence[Fitted]) -> set[str]:
    """Name the joints whose links rest in their play mostly where no reading shows it.

    Args:
        observed: readings without noise, with or without the terms: loads hardly depend on them.
    """
    out = set()
    for term in (one for one in terms if one.candidate.target in observed.tree.joints):
        effect, target, values = term.candidate.effect, term.candidate.target, term.values
        if (off := effect.unsure(observed, target, values)) is not None:
            at_rest = effect.remove(observed, target, values).joint_angles
            shown, unseen = at_rest - observed.joint_angles, off.joint_angles - at_rest
            out |= {target} if np.vdot(unseen, unseen) > np.vdot(shown, shown) else set()
    return out


def speaks_of(candidate: Candidate, joints: set[str]) -> bool:
    """Whether a candidate says that the encoder of one of these joints errs.

    Where its link rests depends on the loads in ways that no model says, and passes for such an error.
    """
    kind, _, place = candidate.target.partition("/")[0].rpartition(":")
    return candidate.effect.misreads and place in joints and kind in ("", ENCODER)

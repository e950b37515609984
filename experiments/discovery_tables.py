"""Tables of a discovery."""

import math
from collections.abc import Iterable, Sequence
from statistics import NormalDist
from typing import Any

from tulip_testbed.base.errors import listed
from tulip_testbed.base.numbers import number
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.discovery.detectability import Undetectable, WeaklyDetectable
from tulip_testbed.discovery.discover import clear_of_zero
from tulip_testbed.discovery.dynamics_check import DynamicsCheck
from tulip_testbed.discovery.experiment_information import Explanation
from tulip_testbed.discovery.held_out import HeldOut
from tulip_testbed.discovery.patterns import Pattern
from tulip_testbed.discovery.pure_error import PureError
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.identification_result import Identification

BY_CHANCE = 0.05  # probability that noise alone marks any parameter as moved
MOST_P = 0.05  # above it a pattern in the residuals gets no row
CHANNEL_NAMES = {
    "A": "A, centre of pressure",
    "F": "F, sum of the vertical forces",
    "T": "T, twist, or the force's direction",
    "C": "C, closure of the legs",
    "AFTC": "all channels",
}


def gap_table(heldout: HeldOut) -> Table:
    """Return the residuals by channel before and after, and what chance alone may give."""
    heads = ("channel", *((name, "", ".2f") for name in ("before", "after", "by chance up to")))
    rows: list[list[Any]] = []
    for channel, name in CHANNEL_NAMES.items():
        if channel in heldout.before:
            rows.append([name, *(side[channel] for side in (heldout.before, heldout.after, heldout.floor))])
    rows.append(["centre of pressure, mm r.m.s. per axis", *heldout.millimetres])
    rows.append(["sum of the vertical forces, N r.m.s.", *heldout.newtons])
    note = (
        "Before: the nominal model, everything exact. After: ordinary imperfections and the explanations, "
        "estimated from the other placements. Both are relative to the noise and to what those placements "
        "leave open, such as unknown zeros. In millimetres and newtons the last number is the noise."
    )
    return Table("Residuals on held-out placements, as multiples of the noise", heads, rows, note)


def explanation_table(explanations: Sequence[Explanation]) -> Table:
    factors = ("ln of Bayes factor", "", ".1f"), ("behind the best", "", ".1f")
    heads = (("gap", "", "d"), "effect", "size", *factors)
    rows = [
        [one.gap, one.instance.label, _sizes(one.instance), one.log_bayes_factor, short]
        for one, short in zip(explanations, behind(explanations), strict=True)
    ]
    note = "±: half of the 95 % interval. Rows of one gap explain the same part of the residuals."
    return Table("Explanations", heads, rows, note)


def calibrated_table(members: Iterable[EffectInstance]) -> Table:
    """Return the ordinary imperfections that were added to the model and differ from zero."""
    rows = [[member.label, _sizes(member)] for member in members if clear_of_zero(member)]
    which = "±: half of the 95 % interval. The others" if rows else "All of them"
    note = f"{which} are zero within their 95 % intervals."
    return Table("Calibrated", ("imperfection", "size"), rows, note)


def behind(explanations: Sequence[Explanation]) -> list[float]:
    """Return by how much ln of the Bayes factor of each falls short of the best of its gap."""
    best: dict[int, float] = {}
    for one in explanations:
        best[one.gap] = max(best.get(one.gap, -math.inf), one.log_bayes_factor)
    return [best[one.gap] - one.log_bayes_factor for one in explanations]


def _sizes(instance: EffectInstance) -> str:
    intervals = instance.intervals or (None,) * len(instance.values)
    parameters = instance.effect.parameters_on(instance.target)
    return "; ".join(
        f"{parameter.name} {parameter.text(value, interval)}"
        for parameter, value, interval in zip(parameters, instance.values, intervals, strict=True)
    )


def moves(before: Identification, after: Identification | None) -> list[float | None]:
    """Return by how many standard errors each parameter moved; None each: nothing was corrected."""
    if after is None:
        return [None] * len(before)
    change = after.full.value - before.full.value
    return (change / after.full.clustered_standard_error).tolist()


def moved_table(
    before: Identification,
    after: Identification | None,
    adopted: Sequence[EffectInstance],
    all_of_them: bool = True,
) -> Table:
    """Return the base parameters without and with the correction; one estimate if nothing was corrected.

    Args:
        adopted: effects that were removed.
        all_of_them: whether those that hardly moved are listed too.
    """
    bound, estimate, new = least_move(len(before)), before.full, (after or before).full
    errors = new.clustered_standard_error
    millimetres = "mm", ".2f", 1e3
    title = "Base parameters before and after the correction" if adopted else "Base parameters"
    first = "before: no corrections" if adopted else "estimate: no corrections"
    corrected = [("after: corrected", *millimetres)] if adopted else []
    moved = [("moved by", "s.e.", "+.2f"), "change"] if adopted else []
    error = ("s.e.", *millimetres)
    heads = (("no.", "", "d"), "parameter", (first, *millimetres), *corrected, error, *moved)
    lines = []
    for k, move in enumerate(moves(before, after)):
        mark = "moved" if abs(move or 0.0) > bound else ""
        if not (mark or all_of_them):
            continue
        values = [int(estimate.numbers[k]), estimate.names[k], estimate.value[k]]
        values += [new.value[k], errors[k], move, mark] if adopted else [errors[k]]
        lines.append([Cell(value, mark) for value in values])
    return Table(title, heads, lines, moved_words(before, after, adopted))


def least_move(count: int) -> float:
    """Return the move [standard errors] that noise exceeds in any of `count` parameters at most once in 20.

    Bonferroni's bound, which holds however the parameters are correlated.
    """
    return NormalDist().inv_cdf(1 - BY_CHANCE / (2 * max(count, 1)))


def moved_words(
    before: Identification, after: Identification | None, adopted: Sequence[EffectInstance]
) -> str:
    """Say what was assumed, how many base parameters moved, and what counts as moved."""
    if not adopted:
        return (
            "No effect was removed, so there is one estimate of the base parameters: by the self-calibrating "
            "estimator, which estimates ordinary imperfections with them."
        )
    bound = least_move(len(before))
    sizes = {name: abs(move or 0.0) for name, move in zip(before, moves(before, after), strict=True)}
    count = sum(size > bound for size in sizes.values())
    largest = max(sizes, key=lambda name: sizes[name])
    removed = listed([effect.label for effect in adopted])
    return (
        f"{count or 'None'} of {len(before)} parameters moved by more than {bound:.1f} standard errors, "
        f"which noise exceeds in any of them at most once in 20 times; the largest move is "
        f"that of {largest}, {sizes[largest]:.1f}. Before: nothing removed from the measurements. After: "
        f"{removed} removed. Both by the self-calibrating estimator, which estimates ordinary imperfections "
        "with the base parameters and takes up a part of the effect before."
    )


def pattern_table(patterns: Sequence[Pattern]) -> Table:
    heads = ("channel", "pattern", ("p", "", ".2g"))
    rows = [[one.channel, one.words, one.p] for one in patterns if one.p < MOST_P]
    return Table("The clearest patterns in the remaining residuals", heads, rows)


def repeat_table(repeats: PureError) -> Table:
    """Return how repeated postures agree with the stated noise."""
    heads = ("channel", ("chi² per degree of freedom", "", ".2f"), ("p", "", ".2g"))
    rows = [
        [CHANNEL_NAMES.get(channel, channel), ratio, repeats.p.get(channel)]
        for channel, ratio in repeats.ratio.items()
    ]
    return Table("Repeated postures against the stated noise", heads, rows)


def undetectable_table(effects: Sequence[Undetectable]) -> Table:
    biased = ("biases most the parameter no.", "", "d"), ("by, per prior s.d.", "mm", ".2f", 1e3)
    by_name: dict[str, list[Undetectable]] = {}
    for effect in effects:
        by_name.setdefault(effect.candidate.effect.name, []).append(effect)
    rows = []
    for name, of in by_name.items():
        worst = max(of, key=lambda effect: effect.bias)
        bias = [worst.parameter, worst.bias] if worst.parameter else ["not predicted", None]
        rows.append([name, _targets(of), *bias])
    return Table("Effects that these postures cannot detect", ("effect", "targets", *biased), rows)


def weak_table(effects: Sequence[WeaklyDetectable]) -> Table:
    """Return the effects that show only if larger than plausible, one kind per row."""
    heads = ("effect", "targets", "shows from (90 %)", "over the plausible size")
    by_unit: dict[tuple[str, str], list[WeaklyDetectable]] = {}
    for effect in sorted(effects, key=lambda effect: effect.multiple):
        by_unit.setdefault((effect.candidate.effect.name, effect.size.unit), []).append(effect)
    rows = []
    for (name, _), of in by_unit.items():
        ends = of[0], of[-1]
        sizes = [effect.size.text(effect.least) for effect in ends if effect.least is not None]
        least = _from_to(sizes) if sizes else "several numbers"
        rows.append(
            [name, _targets(of), least, _from_to([number(effect.multiple, ".2g") for effect in ends])]
        )
    return Table("Effects that show only if larger than plausible", heads, rows)


def _targets(effects: Sequence[Undetectable | WeaklyDetectable]) -> list[str]:
    return [effect.candidate.target for effect in effects if effect.candidate.target]


def _from_to(ends: list[str]) -> str:
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)


def dynamics_line(check: DynamicsCheck) -> str:
    if check.reason:
        return f"In full dynamics nothing could be compared: {check.reason}."
    return (
        f"In full dynamics {check.postures} of {check.tried} postures stood; the residual after "
        f"removing the adopted effects is {check.left:.2f} times the noise."
    )

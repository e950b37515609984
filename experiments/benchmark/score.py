"""Scores of the outcomes: shares with exact intervals, each with its target."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom

from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import split_label
from tulip_testbed.experiments.benchmark import cases as arms
from tulip_testbed.experiments.benchmark.case_outcome import Outcome
from tulip_testbed.experiments.benchmark.outside_faults import OUTSIDE
from tulip_testbed.experiments.montecarlo.intervals import share

CONFIDENCE = 0.95
HELD_OUT = 1.1  # times the noise
BIASED = 1.0  # standard error: a bias that ought to be removed
REDUCED = 0.7
LATE = {fault.name for fault in OUTSIDE if fault.late}


@dataclass(frozen=True)
class Figure:
    """One figure of the benchmark.

    Attributes:
        value, low, high: NaN where there was no case.
        count: of cases (of intervals, for coverage). least, most: what it must reach, None: no demand.
    """

    name: str
    value: float
    low: float
    high: float
    count: int
    least: float | None = None
    most: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the value is what it must be; None: no demand, or no case."""
        if (self.least is None and self.most is None) or not self.count:
            return None
        return (self.least is None or self.value >= self.least) and (
            self.most is None or self.value <= self.most
        )


def rate(name: str, hits: Iterable[bool], least: float | None = None, most: float | None = None) -> Figure:
    """Return a share with the interval of Clopper and Pearson (1934)."""
    each = [bool(hit) for hit in hits]
    if not each:
        return Figure(name, np.nan, np.nan, np.nan, 0, least, most)
    found = share(np.array([sum(each)]), len(each), CONFIDENCE)
    low, high = found.interval[:, 0].tolist()
    return Figure(name, float(found.value[0]), low, high, len(each), least, most)


def median(
    name: str, values: Iterable[float], least: float | None = None, most: float | None = None
) -> Figure:
    """Return a median with the interval between order statistics (binomial, exact)."""
    ordered = np.sort(np.array(list(values), float))
    n = len(ordered)
    if not n:
        return Figure(name, np.nan, np.nan, np.nan, 0, least, most)
    # The largest number of values beyond each end that chance exceeds seldom enough; below six there is none.
    first = int(binom.ppf((1 - CONFIDENCE) / 2, n, 0.5)) - 1
    low, high = (-np.inf, np.inf) if first < 0 else ordered[[first, n - 1 - first]].tolist()
    return Figure(name, float(np.median(ordered)), low, high, n, least, most)


def right(o: Outcome) -> bool:
    """Test if the true name is first, with the true choice, or is the clearest ordinary imperfection."""
    return (o.said and o.names[:1] == list(o.hidden) and _held_by(o, 0)) or _clearest(o)


def _clearest(o: Outcome) -> bool:
    """Whether the clearest ordinary imperfection is what was hidden, with its sign, and nothing is named."""
    if o.verdict != "calibrated" or not o.calibrated or len(o.hidden) != 1:
        return False
    first, true = o.calibrated[0], o.values[0]
    same = zip(first.values, true, strict=True) if first.label == o.hidden[0] else ()
    return any(a * b > 0 for a, b in same)


def in_set(o: Outcome) -> bool:
    """Test if the true effect is among the explanations of a gap, or the clearest ordinary imperfection."""
    return (o.said and _held_by(o, 0)) or _clearest(o)


def wrong(o: Outcome) -> bool:
    """Confidently named, and not what was hidden; or a law, where the catalogue holds what was hidden."""
    lawful = o.arm in (arms.OUTSIDE_ARM, arms.LEFT_OUT)
    return (o.verdict == "named" and not exactly(o)) or (o.verdict == "described" and not lawful)


def _held_by(o: Outcome, k: int) -> bool:
    """Whether a gap's explanations hold hidden effect k; the one that was fitted with the true choice."""
    label = o.hidden[k]
    return any(
        label in term.alike
        and (term.label != label or _choice(label, term.values) == _choice(label, o.values[k]))
        for term in o.found
    )


def _choice(label: str, values: Sequence[float]) -> set[float]:
    """Return the choice among several things, such as two corners."""
    parameters = catalogue()[split_label(label)[0]].parameters
    return {value for parameter, value in zip(parameters, values, strict=True) if parameter.choices}


def twin_said(o: Outcome) -> bool:
    """Return whether the omitted effect is explained by its look-alikes alone."""
    return o.said and set(o.names) <= set(o.twins[0])


def unknown_or_twin(o: Outcome) -> bool:
    """Return the right answers where the true effect is not in the catalogue."""
    return open_said(o) or twin_said(o)


def open_said(o: Outcome) -> bool:
    """No cause of the catalogue is reported: at most a law, whose cause is a guess."""
    return o.verdict in ("unknown", "described")


def set_size(o: Outcome) -> int:
    """Of the set with the true effect; of the largest where it is in none."""
    own = [len(t.alike) for t in o.found if o.hidden[0] in t.alike]
    return max(own or [len(t.alike) for t in o.found])


def of(
    outcomes: Sequence[Outcome], arm: str, keep: Callable[[Outcome], bool] = lambda o: True
) -> list[Outcome]:
    """Cases of an arm that gave data."""
    return [o for o in outcomes if o.arm == arm and not o.failed and keep(o)]


def figures(outcomes: Sequence[Outcome]) -> list[Figure]:
    """All figures of one preset, of statics or of dynamics."""
    single = of(outcomes, arms.SINGLE)
    clear = [o for o in single if o.multiple >= 2]
    explained = [o for o in clear if o.found]
    biased = [o for o in single if o.bias is not None and o.bias.largest >= BIASED]
    reduced = [1 - o.bias.after / o.bias.before for o in biased if o.bias is not None]
    held = [o for o in single if o.multiple >= 1 and o.held is not None and o.said]
    pairs = of(outcomes, arms.SEVERAL, lambda o: len(o.kinds) == 2)
    triples = of(outcomes, arms.SEVERAL, lambda o: len(o.kinds) == 3)
    outside, left = of(outcomes, arms.OUTSIDE_ARM), of(outcomes, arms.LEFT_OUT)
    absorbed = of(outcomes, arms.ABSORBED)
    return [
        rate("false alarms on nulls", (o.flagged for o in of(outcomes, arms.NULL)), most=0.02),
        rate("false alarms, robots unlike the nominal one", (o.flagged for o in of(outcomes, arms.ROBOTS))),
        rate(
            "power at the predicted minimum detectable size (MDE)",
            (o.flagged for o in single if o.multiple == 1),
            least=0.85,
            most=0.95,
        ),
        rate("right name first, isolable, from 2 MDE on", map(right, filter(_isolable, clear)), least=0.95),
        rate("right name first, all, from 2 MDE on", map(right, clear)),
        rate("true effect in the set, from 2 MDE on", map(in_set, clear), least=0.95),
        median("median size of the set", map(set_size, explained), most=2.0),
        rate("one wrong name, confidently, of all single effects", map(wrong, single), most=0.03),
        rate("unknown or a law said, outside the catalogue", map(open_said, outside), least=0.9),
        rate(
            "unknown or a law said, outside, where the closest entry leaves 1 MDE",
            (open_said(o) for o in outside if o.remainder >= 1),
            least=0.9,
        ),
        rate(
            "unknown or a law said, outside, faults thought of after the discovery was fixed",
            (open_said(o) for o in outside if o.kinds[0] in LATE),
        ),
        rate("wrong name, outside", (o.verdict == "named" for o in outside)),
        rate("left out: unknown, or a twin said", map(unknown_or_twin, left), least=0.9),
        rate(
            "left out: the same, where the closest entry leaves 1 MDE",
            (unknown_or_twin(o) for o in left if o.remainder >= 1),
            least=0.9,
        ),
        rate(
            "left out: wrong name that is no twin's",
            (o.verdict == "named" and not twin_said(o) for o in left),
        ),
        rate("held-out whitened r.m.s. at most 1.1 before", (o.held[0] <= HELD_OUT for o in held if o.held)),
        rate("held-out whitened r.m.s. at most 1.1 after", (o.held[1] <= HELD_OUT for o in held if o.held)),
        median("median held-out whitened r.m.s. before", (o.held[0] for o in held if o.held)),
        median("median held-out whitened r.m.s. after", (o.held[1] for o in held if o.held), most=HELD_OUT),
        rate("95 % intervals of the size hold it", (c for o in single for c in o.coverage), 0.9, 0.98),
        rate("95 % intervals of the size hold it, from 2 MDE on", (c for o in clear for c in o.coverage)),
        rate("95 % intervals of a time hold it", (c for o in single for c in o.times)),
        median("median part of the parameters' bias removed", reduced, least=REDUCED),
        rate("at least 70 % of the bias removed", (part >= REDUCED for part in reduced)),
        rate("pairs: both found first, nothing else", map(exactly, pairs), least=0.8),
        rate("pairs: the same, isolable", map(exactly, filter(_isolable, pairs))),
        rate("pairs: the same, and both named", (o.verdict == "named" and exactly(o) for o in pairs)),
        rate("pairs: each in a set", map(each_in_set, pairs)),
        rate("triples: all found first, nothing else", map(exactly, triples)),
        rate("triples: each in a set", map(each_in_set, triples)),
        rate("absorbed: no gap seen, and listed as unseen", (not o.flagged and o.unseen for o in absorbed)),
        rate("absorbed: a parameter that it would bias is reported", (o.biased > 0 for o in absorbed)),
        rate("cases without data", (bool(o.failed) for o in outcomes)),
    ]


def _isolable(o: Outcome) -> bool:
    return o.isolable


def exactly(o: Outcome) -> bool:
    """All that was hidden stands first in a set, and nothing else."""
    there = all(_held_by(o, k) for k in range(len(o.hidden)))
    return o.said and set(o.names) == set(o.hidden) and there


def each_in_set(o: Outcome) -> bool:
    """All that was hidden is among the explanations."""
    return o.said and all(_held_by(o, k) for k in range(len(o.hidden)))

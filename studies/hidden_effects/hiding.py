"""Draw the laboratory of a case and hide something in it that it shows clearly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from studies.hidden_effects.clearness import Clearness
from studies.hidden_effects.laboratories import Built, draw_laboratory, tolerance_of
from studies.hidden_effects.outside_faults import FAULTS
from studies.hidden_effects.readings import Values
from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.catalogue import catalogue, effects_on, targets_in
from tulip_testbed.effects.instance import effect_label, split_label
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot

NOTHING, ONE, TWO, OUTSIDE = "nothing", "one", "two", "outside"
BEYOND = (5.0, 10.0)  # times the tolerance of an effect that has one
PLAUSIBLE = (1.0, 3.0)  # times the plausible size of another
CLEAR = (6.0, 12.0)  # least s.e. by which an experiment shows what is hidden
MOST_PRIORS = 8.0  # no larger effect is hidden
BIASED = 2.0  # s.e. by which a fault outside the catalogue moves a base parameter at least
STANDS_OUT = 3.0  # tolerances: naming an ordinary member from here on is right
INVISIBLE = ("payload",)  # the base parameters are those of the loaded robot


@dataclass(frozen=True)
class Case:
    """One data set to be made.

    Attributes:
        arm: see the study. preset: of the sensors.
        kinds: of the effects, or the name of the fault outside the catalogue.
        dynamics: whether it is measured in the full dynamics.
    """

    arm: str
    preset: str
    kinds: tuple[str, ...] = ()
    dynamics: bool = False


@dataclass(frozen=True)
class Truth:
    """The faults of a laboratory.

    Attributes:
        hidden: values of the effects of the catalogue that were hidden, by their labels.
        outside: a fault outside the catalogue, with its size. culprits: what errs then, as laws say it.
        shows: s.e. by which the experiment shows each of these. bias: s.e. by which all move a parameter.
        large: labels of ordinary members that stand out.
    """

    hidden: Mapping[str, Values] = field(default_factory=dict)
    outside: str = ""
    culprits: tuple[str, ...] = ()
    shows: tuple[float, ...] = ()
    bias: float = 0.0
    large: tuple[str, ...] = ()


def hidden_kinds() -> list[str]:
    """List the effects that can be hidden."""
    return [e.name for e in effects_on(None, statics=True) if e.searched and e.name not in INVISIBLE]


def draw_trial(
    case: Case, robot: Robot, plan: PosturePlan, stream: int, rng: np.random.Generator
) -> tuple[Built, Truth]:
    """Draw a laboratory and hide what the case says.

    Args:
        stream: seed of the experiment, from which the size of what is clear follows too.

    Raises:
        InputError: the robot falls, or no effect of the kind shows clearly.
    """
    built = draw_laboratory(robot, case.preset, rng, case.dynamics)
    tolerances = {label: tolerance_of(split_label(label)[0], case.preset) for label in built.effects}
    of_sizes = {label: max(map(abs, values)) / tolerances[label] for label, values in built.effects.items()}
    large = tuple(label for label, size in of_sizes.items() if size >= STANDS_OUT)
    if case.arm == NOTHING:
        return built, Truth(large=large)
    clearness = Clearness(built, plan, stream)
    if case.arm == OUTSIDE:
        (fault,) = (one for one in FAULTS if one.name == case.kinds[0])
        number, size = int(rng.integers(1000)), _between(fault.sizes, rng)
        size *= 1.0 if fault.positive else float(rng.choice([-1.0, 1.0]))
        shows, bias = clearness.of(fault.put(clearness.plain, number, size))
        if bias < BIASED:
            raise InputError(f"{fault.name}: found a bias of {bias:.1f} s.e., expected {BIASED:g} or more")
        truth = Truth({}, f"{fault.name}:{number}={size:.3g}", fault.culprits(robot, number), (shows,), bias)
        return fault.put(built, number, size), truth
    hidden: dict[str, Values] = {}
    shown = []
    for kind in case.kinds:
        label, values, clear = _clear(kind, clearness, set(hidden), rng)
        hidden[label] = values
        shown.append(clear)
    _, bias = clearness.of(clearness.plain.with_effects(hidden))
    return built.with_effects(hidden), Truth(hidden, shows=tuple(shown), bias=bias, large=large)


def _clear(
    kind: str, clearness: Clearness, taken: set[str], rng: np.random.Generator
) -> tuple[str, Values, float]:
    """Draw an effect of a kind that is no ordinary member and that the experiment shows clearly."""
    effect, built = catalogue()[kind], clearness.built
    places = tuple(np.unique(clearness.plan.placement).tolist())
    least, tolerance = _between(CLEAR, rng), tolerance_of(kind, built.preset)
    priors = np.array([p.prior for p in effect.parameters])
    for target in rng.permutation(targets_in(effect, built.rig.robot, None, places)).tolist():
        if (label := effect_label(kind, target)) in taken:
            continue
        grid = np.array([float(rng.choice(p.grid)) if p.grid else 0.0 for p in effect.parameters])
        if kind == "swapped-cells":
            grid = np.sort(rng.choice(4, 2, replace=False)).astype(float)
        way = np.where(priors > 0, rng.standard_normal(len(priors)), 0.0)
        way = np.where([p.positive for p in effect.parameters], np.abs(way), way)
        way *= (tolerance or priors) / max(float(np.abs(way).max()), 1e-300)
        way *= _between(BEYOND if tolerance else PLAUSIBLE, rng)
        for _ in range(2):
            values = tuple((grid + way).tolist())
            shown, _ = clearness.of(clearness.plain.with_effects({label: values}))
            if shown >= 0.9 * least:
                return label, values, shown
            way *= least / max(shown, 1e-300)
            if not effect.sizes or (np.abs(way) > MOST_PRIORS * priors).any():
                break
    raise InputError(f"{kind}: no plausible size is clear in this laboratory")


def _between(ends: tuple[float, float], rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(*np.log(ends))))

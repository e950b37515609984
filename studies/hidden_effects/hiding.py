"""Draw the laboratory of a case and hide something in it that it shows clearly."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import cho_factor, cho_solve

from studies.hidden_effects.laboratories import USUAL, Built, draw_laboratory, tolerance_of
from studies.hidden_effects.outside_faults import FAULTS
from studies.hidden_effects.readings import Values
from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.catalogue import catalogue, effects_on, targets_in
from tulip_testbed.effects.instance import effect_label, split_label
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import (
    ROWS,
    by_weight,
    constants_of_stances,
    residuals,
    residuals_in_use,
)
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.robot import Robot

STEP = 1e-4  # of readings, in SI units
WAVES, WANDERING = 3, 0.5  # functions of time by which a zero wanders, and by how much [s.d. of a reading]
FREE = 1e-9  # precision of columns without a prior, of length 1
LEAST_STANDING = 0.75  # of the postures
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
        large: labels of ordinary members that stand out, and of play in encoders.
    """

    hidden: Mapping[str, Values] = field(default_factory=dict)
    outside: str = ""
    culprits: tuple[str, ...] = ()
    shows: tuple[float, ...] = ()
    bias: float = 0.0
    large: tuple[str, ...] = ()


class Clearness:
    """A laboratory's experiment as a linear model: what a fault shows and how far it moves base parameters.

    Both follow from the laboratory's own simulation and from linear least squares, in which ordinary members
    have their tolerances as prior s.d. and all zeros wander by functions of time. No estimator and no verdict
    of the package takes part, so that the cases of the study stay the same when those change.

    Attributes:
        built, plan: the experiment. plain: the laboratory without imperfections, for exact simulations.
    """

    def __init__(self, built: Built, plan: PosturePlan, seed: int):
        self.built, self.plan = built, plan
        tilt = {label: values for label, values in built.effects.items() if label == "tilt"}
        self.plain = replace(built, effects=tilt, noise=())
        measured = built.measured(plan, seed)
        self.nominal, self.postures = nominal_robot(built.rig.robot), measured.posture.tolist()
        observed, theta, sheet = observe(measured, self.nominal), self.nominal.value, measured.sensors
        self.used = residuals_in_use(observed)
        here = residuals(observed, theta)

        def change(name: str, size: float, *at: int) -> np.ndarray:
            values = getattr(observed, name).copy()
            values[:, *at] += STEP
            return (residuals(observed.changed(**{name: values}), theta) - here) * (size / STEP)

        joints, cells = observed.joint_angles.shape[1], observed.cell_forces.shape[1]
        own = [change("joint_angles", sheet.encoder_sd or 0.0, j) for j in range(joints)]
        own += [change("cell_forces", sheet.cell_sd or 0.0, c) for c in range(cells)]
        noise = np.where(self.used[..., None], np.stack(own, axis=2), 0.0)
        unused = ~self.used[..., None] * np.eye(self.used.shape[1])
        self.white = np.linalg.inv(np.linalg.cholesky(noise @ noise.mT + unused))
        of_base = np.stack([residuals(observed, theta + unit) - here for unit in np.eye(len(theta))], axis=2)
        poses = np.array([built.rig.sensors.mark_sd, built.rig.sensors.placement_sd])
        plates = np.stack([change("plate_poses", poses[at], *at) for at in np.ndindex(2, 3)], axis=2)
        place = measured.placement[:, None] == np.unique(measured.placement)
        weight = np.zeros((*here.shape, 1))
        weight[:, : ROWS["T"].stop, 0] = (
            by_weight(observed) * measured.gravity * built.rig.sensors.weighed_mass_sd
        )
        members, self.owners = [], []
        for name in USUAL:
            effect, size = catalogue()[name], tolerance_of(name, built.preset)
            for target in targets_in(effect, built.rig.robot, None, ()):
                for unit in np.eye(len(effect.parameters)):
                    without = effect.remove(observed, target, tuple(size * unit))
                    members.append(here - residuals(without, theta))
                    self.owners.append(effect_label(name, target))

        def by_place(columns: np.ndarray) -> np.ndarray:
            return np.einsum("mck,mp->mckp", columns, place).reshape(*here.shape, -1)

        constants = by_place(constants_of_stances(self.used))
        time = (measured.time - measured.time[0]) / np.ptp(measured.time)
        slow = legvander(2 * time - 1, WAVES)[:, 1:] * np.sqrt(2 * np.arange(WAVES) + 3)
        wandering = WANDERING * noise[..., None] * slow[:, None, None]
        known = [by_place(plates), weight, wandering.reshape(*here.shape, -1), np.stack(members, axis=2)]
        self.columns = self._project(np.concatenate([of_base, constants, *known], axis=2))
        self.parameters, free = len(theta), len(theta) + constants.shape[2]
        self.columns[:, :free] /= np.maximum(np.linalg.norm(self.columns[:, :free], axis=0), 1e-300)
        self.prior = np.where(np.arange(self.columns.shape[1]) < free, FREE, 1.0)
        self.level = self._exact(self.plain)

    def _project(self, columns: np.ndarray) -> np.ndarray:
        """Whiten changes of the residuals, (m, 11, k) -> (11 m, k)."""
        return (self.white @ np.where(self.used[..., None], columns, 0.0)).reshape(-1, columns.shape[2])

    def _exact(self, built: Built) -> np.ndarray:
        """Simulate the residuals of every posture without noise, (m, 11); not a number: none can be used."""
        measured = built.measured(self.plan, 0, exact=True)
        observed = observe(measured, self.nominal)
        left = np.where(residuals_in_use(observed), residuals(observed, self.nominal.value), np.nan)
        known = dict(zip(measured.posture.tolist(), left, strict=True))
        return np.array([known.get(posture, np.full(left.shape[1], np.nan)) for posture in self.postures])

    def of(self, faulty: Built) -> tuple[float, float]:
        """Return by how many s.e. a fault shows, and the most by which it moves a base parameter.

        A posture in which the robot falls, or stands on other cells, with or without it shows nothing.

        Args:
            faulty: `plain` with the fault. An ordinary member of its label has no prior.

        Raises:
            InputError: with the fault many postures are such.
        """
        signal = self._exact(faulty) - self.level
        stands = np.all(np.isfinite(signal) | ~self.used, axis=1)
        if stands.mean() < LEAST_STANDING:
            raise InputError(f"the robot falls or tips in {(~stands).sum()} of {len(stands)} postures")
        (white,) = self._project(np.where(stands[:, None], signal, 0.0)[..., None]).T
        own = {k for k, v in faulty.effects.items() if self.plain.effects.get(k) != v}
        kept = np.append(
            np.ones(len(self.prior) - len(self.owners), bool), [k not in own for k in self.owners]
        )
        columns = self.columns[:, kept] * np.repeat(stands, self.used.shape[1])[:, None]
        factor = cho_factor(columns.T @ columns + np.diag(self.prior[kept]))
        moved = cho_solve(factor, columns.T @ white)
        errors = np.sqrt(np.diag(cho_solve(factor, np.eye(len(moved)))))
        left = white @ white - (columns.T @ white) @ moved
        return float(np.sqrt(max(left, 0.0))), float(np.abs(moved / errors)[: self.parameters].max())


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
    large = (*built.played, *(label for label, size in of_sizes.items() if size >= STANDS_OUT))
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
        errs, text = fault.culprits(robot, number), f"{fault.name}:{number}={size:.3g}"
        return fault.put(built, number, size), Truth({}, text, errs, (shows,), bias, large)
    hidden: dict[str, Values] = {}
    shown = []
    for kind in case.kinds:
        label, values, clear = clear_effect(kind, clearness, set(hidden), rng)
        hidden[label] = values
        shown.append(clear)
    _, bias = clearness.of(clearness.plain.with_effects(hidden))
    return built.with_effects(hidden), Truth(hidden, shows=tuple(shown), bias=bias, large=large)


def clear_effect(
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

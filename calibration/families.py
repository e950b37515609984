"""Families of ordinary imperfections: what is a little wrong in every laboratory, and by how much.

A family holds alike errors, such as the zeros of all encoders. Its tolerance is the size that is usual for
the sensors; how large the errors of a laboratory really are, in tolerances, is estimated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import Self

import numpy as np

from tulip_testbed.base.errors import InputError, look_up, shortened
from tulip_testbed.effects.catalogue import NamedEffect, catalogue, every_effect, targets_in
from tulip_testbed.effects.instance import MOST_PRIORS, EffectInstance, effect_label
from tulip_testbed.effects.motion_effects import DAMPING, INERTIA, LAG, directions
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import SensorSheet
from tulip_testbed.measurements.bounds import LEAST_DEVIATION
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.measurements.contacts import WRENCH, Contacts
from tulip_testbed.measurements.manipulations import Experiment
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.sensors import PRESETS

DELAY = 0.03  # s, of a sole that yields; assumed
# Tolerance of every family [SI] by preset. Assumed: no data sheet states them.
TOLERANCES: dict[str, tuple[float, float]] = {
    # name: (wii, force-plate)
    "encoder-offset": (np.radians(0.15), np.radians(0.15)),
    "encoder-wander": (2e-4, 5e-5),
    "encoder-gain": (0.003, 0.003),
    "link-length": (5e-4, 5e-4),
    "joint-compliance": (np.radians(0.01), np.radians(0.01)),
    "sole-compliance": (np.radians(0.01), np.radians(0.01)),
    "cell-gain": (0.01, 0.003),
    "cell-tare": (0.5, 0.05),
    "cell-wander": (0.7, 0.05),
    "cell-crosstalk": (0.003, 0.001),
    "cell-position-scale": (0.003, 0.001),
    "thermal-gain-drift": (0.003, 0.001),
    "plate-translation": (2e-3, 3e-4),
    "plate-yaw": (np.radians(0.5), np.radians(0.05)),
    "tilt": (np.radians(0.2), np.radians(0.2)),
    "wrench-gain": (0.01, 0.003),
    # Of sensors in feet; no preset has finer ones. A load makes another channel read 1 % of its range:
    # me-systeme.de, "Accuracy of multi-component sensors" (HITEC: 1 to 5 % before a correction by a matrix).
    "wrench-crosstalk": (0.01, 0.01),
    "wrench-rotation": (np.radians(0.5), np.radians(0.5)),
    "wrench-origin": (1e-3, 1e-3),
    "foot-compliance": (np.radians(0.5) / 20,) * 2,  # of one foot about one axis, with six axes; assumed
    "wrench-drift": (1.0, 1.0),  # 0.1 % of a range of 1000 N
    # Good plates state errors of a centre of pressure of some tenths of a millimetre (assumed). A map leaves
    # 0.54 of a coefficient's s.d. over a plate after an affine fit. A real AMTI plate at 20 points against
    # motion capture (MobMonRob/InverseDynamicsWithForcePlate) leaves 3.7 and 2.2 mm, errors of the motion
    # capture among them. A balance board may err by 3 mm, but there 2 mm of `plate-translation` and gains of
    # 1 % hide it: nothing was gained with it. Sensors between the presets have none.
    "plate-map": (0.0, 3e-4),
    "cell-side-force": (0.0, 0.0),  # none unless stated: what plain cells read of a side force is not known
    "inertia": (1.0, 1.0),  # of CAD's uncertainty, of a robot that moves
    "contact-lag": (0.01, 0.002),  # s, of plates under a robot that moves; assumed
    "foot-damping": (DELAY * np.radians(0.5) / 20,) * 2,  # of feet with six axes that move; assumed
}
EXACT = dict.fromkeys(TOLERANCES, 0.0)  # tolerances of a laboratory without ordinary imperfections
OF_PLATES = (
    "plate-translation",
    "plate-yaw",
)  # scale with the s.d. of a placement, the others with the cells'
SOLE = "foot-compliance"
DRIFTS = ("wrench-drift", "encoder-wander", "cell-wander")  # none in a log of a minute
TIPPING = 0.1  # of the compliance with which a robot would tip over, 1 / (height x weight); assumed
# Squared mean of the absolute value of a standard normal deviate.
COMMON = 2 / np.pi


@dataclass(frozen=True)
class Tolerances:
    """Tolerance of every family.

    Attributes:
        value: by the family's name [SI]; zero: the family is exact and is left out.
        assumed: how the sensors' data sheet led to them.
    """

    value: Mapping[str, float]
    assumed: str


@dataclass(frozen=True)
class Family:
    """An effect on all of its targets.

    Attributes:
        tolerance: s.d. of each of its numbers at spread 1, in the effect's own unit [SI]; see `sizes`.
        targets: (n,).
        known: s.d. of each number if it is known from elsewhere, so that no spread is estimated; the
            tolerance is then that of the first [SI].
        about: means of the prior of the numbers, if not all are zero [SI].
    """

    effect: NamedEffect
    tolerance: float
    targets: tuple[str, ...]
    known: tuple[float, ...] = ()
    about: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """Return the name of the effect."""
        return self.effect.name

    @property
    def positive(self) -> bool:
        """Whether its numbers cannot be negative."""
        return self.effect.parameters[0].positive

    def __len__(self) -> int:
        return len(self.targets) * len(self.effect.parameters)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Return the name of every number, `effect:target` or `effect:target, parameter`."""
        return tuple(
            name for instance in self.instances(np.zeros(len(self))) for name in instance.named_values
        )

    @cached_property
    def parts(self) -> tuple[np.ndarray, ...]:
        """Return how the numbers arise from independent deviates of s.d. 1 at spread 1, (n, k) each [SI].

        Every part has a spread of its own. Numbers of either sign are independent. Numbers that cannot be
        negative have a common mean and independent differences; the second moments at spread 1 are those of
        absolute values of normal deviates.
        """
        n = len(self)
        if self.known:
            return (np.diag(self.known),)
        if not self.positive or n == 1:
            return (np.diag(self.sizes),)
        return (
            self.tolerance * np.sqrt(COMMON) * np.ones((n, 1)),
            self.tolerance * np.sqrt(1 - COMMON) * np.eye(n),
        )

    @property
    def steps(self) -> np.ndarray:
        """Return a plausible size of every number, (n,) [SI]."""
        return np.array([p.prior for target in self.targets for p in self.effect.parameters_on(target)])

    @cached_property
    def sizes(self) -> np.ndarray:
        """Return the tolerance of every number in its own unit, (n,) [SI]."""
        usual = np.tile([parameter.prior for parameter in self.effect.parameters], len(self.targets))
        return np.array(self.known) if self.known else self.tolerance * (self.steps / usual)

    @property
    def center(self) -> np.ndarray:
        """Return the mean of the prior of every number, (n,) [SI]."""
        return np.array(self.about) if self.about else np.zeros(len(self))

    def instances(self, values: np.ndarray) -> list[EffectInstance]:
        """Return the family's effects with these values, (n,)."""
        each = values.reshape(len(self.targets), -1).tolist()
        return [EffectInstance(self.effect, t, tuple(v)) for t, v in zip(self.targets, each, strict=True)]

    def lying_about(self, sizes: Mapping[str, tuple[float, ...]]) -> Self:
        """Return the family with these means of the prior, by label; the others are zero."""
        zero = (0.0,) * len(self.effect.parameters)
        each = [sizes.get(effect_label(self.name, target), zero) for target in self.targets]
        return replace(self, about=sum(each, ())) if any(map(any, each)) else self

    def single(self, number: int, value: float) -> EffectInstance:
        """Return the effect in which one of the numbers has this value and the others are zero."""
        values = [0.0] * len(self.effect.parameters)
        target, parameter = divmod(number, len(values))
        values[parameter] = value
        return EffectInstance(self.effect, self.targets[target], tuple(values))


def tolerances_of(sheet: SensorSheet, given: Mapping[str, float] | None = None) -> Tolerances:
    """Return the tolerances that fit a data sheet.

    Between the presets, and up to their figures, tolerances follow the s.d. of the cells or of a placement
    by a power law.

    Args:
        given: tolerances that replace those of the table [SI].

    Raises:
        InputError: an unknown family, or a tolerance that is negative or not finite.
    """
    given = given or {}
    check_tolerances(given)
    of_cells = _place(sheet.cell_sd, "cell_repeatability")
    of_plates = _place(sheet.placement_sd and sheet.placement_sd[0], "placement_sd")
    value = {
        name: float(coarse ** (1 - place) * fine**place)
        for name, (coarse, fine) in TOLERANCES.items()
        for place in [of_plates if name in OF_PLATES else of_cells]
    }
    text = {(0.0, 0.0): "those of preset wii", (1.0, 1.0): "those of preset force-plate"}.get(
        (of_cells, of_plates), "assumed, between those of the presets wii and force-plate"
    )
    return Tolerances(value | dict(given), text if not given else f"{text}, and as stated")


def check_tolerances(given: Mapping[str, float], where: str = "tolerances") -> None:
    """Refuse tolerances that no family can have.

    Args:
        where: place of the tolerances, for messages.

    Raises:
        InputError: an unknown family, with those that are close and those that are valid; a tolerance that is
            no number, negative, not finite, or beyond any laboratory.
    """
    for name, value in given.items():
        look_up("family", name, TOLERANCES, where)
        parameter = every_effect()[name].parameters[0]
        most = MOST_PRIORS * parameter.prior
        plausible = isinstance(value, Real) and not isinstance(value, bool) and 0 <= value <= most
        if not plausible or 0 < value < LEAST_DEVIATION:
            unit = f" {parameter.unit}" if parameter.unit else ""
            raise InputError(
                f"{where}: {name}: found {shortened(repr(value))}, expected 0 (exact) or a number "
                f"within [{LEAST_DEVIATION:g}, {most:.3g}]{unit} (SI units)"
            )


def read_tolerances(texts: Sequence[str]) -> dict[str, float]:
    """Read tolerances that are written NAME=VALUE, in SI units.

    Raises:
        InputError: with what was found and what is valid.
    """
    tolerances: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        look_up("family", name, TOLERANCES, "tolerances")
        if name in tolerances:
            raise InputError(f"tolerances: {name}: found two values, expected one")
        try:
            tolerances[name] = float(value)
        except ValueError:
            raise InputError(
                f"tolerances: {name}: found {shortened(repr(text))}, expected {name}=VALUE (SI units)"
            ) from None
    check_tolerances(tolerances)
    return tolerances


def _place(sd: float | None, name: str) -> float:
    """Return where an s.d. lies between those of the presets wii, 0, and force-plate, 1; unknown: 0."""
    if sd is None:
        return 0.0
    coarse, fine = (np.ravel(getattr(PRESETS[preset], name))[0] for preset in ("wii", "force-plate"))
    place = np.log(coarse / max(sd, 1e-300)) / np.log(coarse / fine)
    return float(np.clip(np.round(place, 1), 0.0, 1.0))


def families_of(
    robot: Robot,
    tolerances: Tolerances,
    free: Sequence[EffectInstance] = (),
    contacts: Contacts | None = None,
    experiments: tuple[Experiment, ...] = (),
) -> tuple[Family, ...]:
    """List the families that are not exact, on all targets that a robot and its contact sensors have.

    Args:
        free: effects that are no members of their families.
        contacts: wrench sensors; None: plates on cells.
        experiments: those that were joined; empty: one in an ordinary laboratory.
    """
    others = {(effect.effect.name, effect.target) for effect in free}
    six_axes = contacts is not None and contacts.mount == "foot" and contacts.channels == WRENCH
    other_sole = "sole-compliance" if six_axes else SOLE  # where each foot shows its own tilt
    return tuple(
        Family(effect, tolerances.value[name], targets)
        for name, effect in catalogue().items()
        if tolerances.value.get(name, 0.0) > 0
        and name != other_sole
        and (
            targets := tuple(
                t for t in targets_in(effect, robot, contacts, (), experiments) if (name, t) not in others
            )
        )
    )


def families_in(
    observed: Observation, tolerances: Tolerances, free: Sequence[EffectInstance] = ()
) -> tuple[Family, ...]:
    """List the families of an experiment: those of `families_of`, and zeros of wrench sensors.

    The unknown part of a zero is stated or follows from feet in the air: it has no spread.
    """
    contacts, readings = observed.measurements.contacts, observed.contacts
    families = families_of(
        observed.nominal.robot, tolerances, free, contacts, observed.measurements.experiments
    )
    if observed.cad is not None and observed.measurements.weighed_mass is None:
        # The gain and a weight that nobody knows are one; on one foot fz's own gain is that gain.
        one = set(observed.measurements.support) in ({"right"}, {"left"})
        families = tuple(
            replace(family, targets=tuple(t for t in family.targets if not (one and t.endswith(".fz.fz"))))
            for family in families
            if family.name != "wrench-gain"
        )
    if len(observed) and SOLE in [family.name for family in families]:
        upright = TIPPING / float((observed.height * observed.loaded_weight).max())
        families = tuple(
            replace(family, tolerance=min(family.tolerance, upright)) if family.name == SOLE else family
            for family in families
        )
    if observed.moves:
        in_feet = observed.in_feet and SOLE in [family.name for family in families]
        rocking = in_feet and observed.motion.load_rates.any()
        shown = (
            (INERTIA, directions(observed)),
            (LAG, () if observed.in_feet else ("",)),
            (DAMPING, PLATES if rocking else ()),
        )
        families = (
            *families,
            *(
                Family(effect, tolerances.value[effect.name], targets)
                for effect, targets in shown
                if targets and tolerances.value.get(effect.name)
            ),
        )
    if observed.moves and observed.in_feet:  # a short record
        families = tuple(family for family in families if family.name not in DRIFTS)
    if contacts is None or readings.zero_sd is None or not readings.zero_sd.any():
        return families
    if readings.unknown is not None and readings.unknown.any():
        # A gain multiplies a zero of unknown size: it could be anything.
        families = tuple(family for family in families if family.name != "wrench-gain")
    sd = {
        f"{foot}.{channel}": float(value)
        for foot, row in zip(PLATES, readings.zero_sd, strict=True)
        for channel, value in zip(contacts.channels, row, strict=True)
        if value > 0
    }
    zeros = Family(catalogue()["wrench-zero"], next(iter(sd.values())), tuple(sd), tuple(sd.values()))
    return (*families, zeros)

"""Draw laboratories in which everything is a little wrong, by laws that the estimator does not assume."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from studies.hidden_effects.readings import (
    LOG,
    READERS,
    Readings,
    Values,
    bend,
    couple,
    play,
    round_off,
    wander,
)
from tulip_testbed.calibration.families import TOLERANCES
from tulip_testbed.discovery.nominal_laboratory import without_noise
from tulip_testbed.effects.catalogue import catalogue, targets_in
from tulip_testbed.effects.injection import always, edited
from tulip_testbed.effects.instance import effect_label, split_label
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import Rig, preset_rig
from tulip_testbed.sim.robot import Robot, joint_names
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

ON_PLATES = ("wii", "force-plate")  # presets, in the order of `TOLERANCES`
USUAL = (
    *("cell-crosstalk", "cell-gain", "cell-position-scale", "cell-tare", "encoder-gain", "encoder-offset"),
    *("joint-compliance", "link-length", "plate-translation", "plate-yaw", "sole-compliance"),
    *("thermal-gain-drift", "tilt"),
)
ROBOTS = (0.05, 0.2)  # spread of masses and centres of mass, see `sim.random_robots`
ABSENT = 0.5  # share of the laboratories in which a family, or noise of another kind, is absent
SPREAD_DOF, WIDEST = 3, 3.0  # of a family: half of a Student t, in tolerances, up to this
MEMBER_DOF, LARGEST = 4, 4.0  # of its members: Student t, in tolerances, up to this
NOISE = (0.7, 1.5)  # times the data sheet
COUPLING, FLOOR, MAP = 0.01, np.radians(0.02), 1e-4  # largest: of the side force, [rad], [m]

Read = Callable[[Readings], None]


def tolerance_of(kind: str, preset: str) -> float:
    """Return the tolerance of a family with the sensors of a preset [SI]; 0: it is no family."""
    return TOLERANCES.get(kind, (0.0, 0.0))[ON_PLATES.index(preset)]


@dataclass(frozen=True)
class Built:
    """A laboratory as it is built.

    Attributes:
        rig: robot, floor and sensors. effects: values of those of the catalogue, by `effect:target`.
        faults, noise: of instruments, outside the catalogue.
        played: what rightly says that the encoders of some joints have a play of one s.d. or more.
    """

    preset: str
    rig: Rig
    effects: Mapping[str, Values]
    faults: tuple[Read, ...] = ()
    noise: tuple[Read, ...] = ()
    played: tuple[str, ...] = ()

    def with_effects(self, effects: Mapping[str, Values]) -> Built:
        """Return the laboratory with more effects, each in the place of that of its label."""
        return replace(self, effects={**self.effects, **effects})

    @property
    def physical(self) -> Rig:
        """Return the rig with the effects that MuJoCo simulates."""
        rig = self.rig
        for label, values in self.effects.items():
            name, target = split_label(label)
            rig = rig if name in READERS else catalogue()[name].inject(rig, target, values)
        return rig

    def measured(
        self, plan: PosturePlan, seed: int, dynamics: bool = False, exact: bool = False
    ) -> Measurements:
        """Carry out the experiment.

        Args:
            exact: as planned, without noise, and with all postures that have an equilibrium.

        Raises:
            InputError: nothing can be measured.
        """
        rig = always(self.physical, without_noise) if exact else self.physical
        if dynamics:
            outcome = run_dynamics(rig, plan, seed)
        else:
            (outcome,) = run_statics(solve_plan(rig, plan), [np.random.SeedSequence(seed)], all_solved=exact)
        sheet = header_of(preset_rig(self.preset, rig.robot)).sensors
        readings = Readings(replace(outcome.measurements, sensors=sheet), rig, plan, seed)
        effects = [(*split_label(label), values) for label, values in self.effects.items()]
        instruments = dict(READERS)
        log = instruments.pop(LOG)  # what is logged in place of a reading has none of its faults
        for name, read in instruments.items():
            for target, values in ((target, values) for kind, target, values in effects if kind == name):
                read(readings, target, values)
        for fault in (*self.faults, *(() if exact else self.noise)):
            fault(readings)
        for target, values in ((target, values) for kind, target, values in effects if kind == LOG):
            log(readings, target, values)
        return readings.measurements


def draw_laboratory(robot: Robot, preset: str, rng: np.random.Generator, dynamics: bool = False) -> Built:
    """Draw a robot, ordinary members of half of all families, and noise of other kinds.

    Args:
        dynamics: leave out side forces in the readings, which only statics can simulate.
    """
    plain = preset_rig(preset, robot)
    s, sheet = plain.sensors, header_of(plain).sensors
    angle, force = sheet.encoder_sd or 0.0, sheet.cell_sd or 0.0
    standard = draw_robot(robot.model, float(rng.uniform(*ROBOTS)), rng)
    encoder, cell, place = rng.uniform(*NOISE, 3)
    sensors = replace(
        s,
        encoder_repeatability=encoder * s.encoder_repeatability,
        cell_repeatability=cell * s.cell_repeatability,
        placement_sd=tuple(place * np.array(s.placement_sd)),
        mark_sd=tuple(place * np.array(s.mark_sd)),
    )
    effects = {"tilt": tuple(rng.uniform(-FLOOR, FLOOR, 2).tolist())} | _members(robot, preset, rng)
    part, seed = np.where(rng.random(6) < ABSENT, 0.0, rng.random(6)), rng.integers(2**32, size=3).tolist()
    names = joint_names(robot.model)
    width = 2 * part[4] * angle * rng.random(len(names))
    loose = [name for name, play_of in zip(names, width, strict=True) if play_of >= angle > 0]
    played = [says.format(name) for name in loose for says in ("lag:{}", "law:encoder:{}/direction/step")]
    noise: list[Read] = [
        partial(couple, size=part[0] * COUPLING, number=seed[0]),
        partial(bend, size=part[1] * MAP, number=seed[1]),
        partial(wander, encoder=part[2] * angle, cell=part[3] * force, seed=seed[2]),
        partial(play, width=width),
        partial(round_off, encoder=2 * part[5] * angle, cell=2 * part[5] * force),
    ]
    present = (part[0] > 0 and not dynamics, True, True, True, part[5] > 0)
    noise = [one for one, here in zip(noise, present, strict=True) if here]
    rig = replace(edited(plain, edit_of(robot.model, standard)), sensors=sensors)
    return Built(preset, rig, effects, noise=tuple(noise), played=tuple(played))


def _members(robot: Robot, preset: str, rng: np.random.Generator) -> dict[str, Values]:
    effects: dict[str, Values] = {}
    for name in (name for name in USUAL if rng.random() > ABSENT):
        parameters, targets = catalogue()[name].parameters, targets_in(catalogue()[name], robot, None, ())
        spread = _within(WIDEST, rng, SPREAD_DOF, 1.0) / np.sqrt(MEMBER_DOF / (MEMBER_DOF - 2))
        for target in targets:
            sizes = [_within(LARGEST, rng, MEMBER_DOF, spread) for _ in parameters]
            values = tolerance_of(name, preset) * np.array(sizes)
            values = np.abs(values) if parameters[0].positive else values
            effects[effect_label(name, target)] = tuple(values.tolist())
    return effects


def _within(most: float, rng: np.random.Generator, freedom: int, spread: float) -> float:
    """Draw a Student t, and again while it is larger."""
    while abs(value := spread * float(rng.standard_t(freedom))) > most:
        pass
    return value

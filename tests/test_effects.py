"""The catalogue: every effect's prediction against simulations with and without it."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from experiments.discovery.channels import ANCHORED, ROWS, residuals
from experiments.effects import catalogue
from experiments.effects.injection import passed
from experiments.effects.seen import see
from experiments.effects.targets import check_target, leg_links
from experiments.scenario import Scenario
from sim.errors import InputError
from sim.laboratory import run_experiment
from sim.measurements import Measurements
from sim.model import CORNERS
from sim.rig import Rig, preset_rig, stages
from sim.static_laboratory import prepare, run_static

PLACEMENTS = 8
# What a millimetre, a newton and a milliradian are worth to each other.
UNIT = np.array([1e-3, 1e-3, 1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3])

SENSORS = {  # of readings alone: predict undoes inject to rounding
    "encoder-offset:right_knee": (0.01,),
    "encoder-gain:left_hip_pitch": (0.01,),
    "encoder-slip:left_knee": (0.01, 0.3),
    "plate-translation:left": (0.003, 0.002),
    "plate-yaw:right": (0.01,),
    "placement-blunder:3": (0.01, -0.005),
    "cell-gain:right.front_left": (0.02,),
    "cell-tare:left.front_left": (1.0,),
    "cell-drift:right.rear_left": (2.0,),
    "thermal-gain-drift": (0.01,),
    "cell-crosstalk": (0.02,),
    "cell-hysteresis": (0.01,),
    "swapped-cells:left": (1, 3),
}
PHYSICS = {  # smallest cosine asked for
    "joint-compliance:right_knee": ((0.0005,), 0.95),
    "joint-compliance:left_ankle_roll": ((0.001,), 0.95),
    "backlash:right_hip_pitch": ((0.005,), 0.95),
    "backlash:left_knee": ((0.005,), 0.95),
    "tilt": ((0.01, 0.02), 0.95),
    "sole-compliance": ((0.0005,), 0.95),
    "cell-position-scale": ((0.02,), 0.95),
    "payload-step:left_lower_leg": ((0.5, 0.34), 0.95),
    "payload-step:torso": ((-0.5, 0.7), 0.95),
    "link-length:right_lower_leg": ((0.001,), 0.95),
    "link-length:left_hip": ((0.001,), 0.95),
    "tether": ((1.0, -1.5), 0.95),
    "tether-spring": ((20.0,), 0.95),
}


@pytest.fixture(scope="module")
def few(plan):
    """The first placements of the default plan."""
    kept = np.isin(plan.placement, np.unique(plan.placement)[:PLACEMENTS])
    names = ("joint_angles", "placement", "posture", "support", "swing_pose")
    return dataclasses.replace(plan, **{name: getattr(plan, name)[kept] for name in names})


@pytest.fixture(scope="module")
def rig(robot) -> Rig:
    return preset_rig("ideal", robot)


@pytest.fixture(scope="module")
def base(rig, few) -> Measurements:
    return statically(rig, few)


def statically(rig, plan) -> Measurements:
    return run_static(prepare(rig, plan), [np.random.SeedSequence(1101)])[0].measurements


def split(text):
    name, _, target = text.partition(":")
    return catalogue()[name], target


def changes(nominal, base, with_it, effect, target, values):
    """What the simulation changed in the residuals and what is predicted, both (k, 11).

    Of the postures in both experiments; what base parameters and a placement's constants absorb is
    taken out of both, as whoever looks for the effect does.
    """
    seen, before = see(with_it, nominal), see(base, nominal)
    rows = {key: k for k, key in enumerate(_keys(base))}
    here = np.array([k for k, key in enumerate(_keys(with_it)) if key in rows])
    there = np.array([rows[_keys(with_it)[k]] for k in here])
    found = residuals(seen, nominal.value)
    cleaned = residuals(effect.predict(seen, target, values), nominal.value)
    differences = (found[here] - residuals(before, nominal.value)[there], (found - cleaned)[here])
    regressor = nominal.parameters.regressor(with_it.joint_angles[here]).reshape(2 * len(here), -1)
    basis = np.linalg.qr(regressor)[0]
    projected = []
    for rows_of in differences:
        part = rows_of / UNIT
        center = part[:, ROWS["A"]].ravel()
        part[:, ROWS["A"]] = (center - basis @ (basis.T @ center)).reshape(-1, 2)
        for number in np.unique(with_it.placement[here]):
            mine = with_it.placement[here] == number
            part[mine, ANCHORED] -= part[mine, ANCHORED].mean(axis=0)
        projected.append(part)
    return projected


def _keys(measurements):
    """Posture and its how-manieth measurement."""
    seen: dict[int, int] = {}
    keys = []
    for number in measurements.posture.tolist():
        seen[number] = seen.get(number, 0) + 1
        keys.append((number, seen[number]))
    return keys


def agreement(simulated, predicted):
    """Cosine, and slope of the simulated on the predicted change."""
    a, b = simulated.ravel(), predicted.ravel()
    return a @ b / np.linalg.norm(a) / np.linalg.norm(b), a @ b / (b @ b)


def test_the_catalogue_is_complete():
    assert set(catalogue()) == {
        "encoder-offset",
        "encoder-gain",
        "encoder-slip",
        "joint-compliance",
        "backlash",
        "tilt",
        "sole-compliance",
        "plate-translation",
        "plate-yaw",
        "placement-blunder",
        "cell-gain",
        "cell-tare",
        "cell-drift",
        "thermal-gain-drift",
        "cell-crosstalk",
        "cell-position-scale",
        "cell-hysteresis",
        "swapped-cells",
        "payload",
        "payload-step",
        "link-length",
        "tether",
        "tether-spring",
        "unsettled",
        "lifted-corner",
    }


@pytest.mark.parametrize("name", catalogue())
def test_an_effect_describes_itself(name, robot):
    effect = catalogue()[name]
    places = (1, 2, 3)
    targets = effect.targets.of(robot, places)
    assert len(set(targets)) == len(targets) > 0
    for target in targets:
        check_target(effect.targets, target, targets, name)
    words = effect.words.format(*("5.0 +- 0.1" for _ in effect.parameters), target="X")
    assert words.endswith(".")
    for parameter in effect.parameters:
        assert (parameter.prior > 0) != bool(parameter.grid)


@pytest.mark.parametrize("text", SENSORS)
def test_predict_undoes_what_instruments_misread(text, rig, few, base, nominal):
    effect, target = split(text)
    found = statically(effect.inject(rig, target, SENSORS[text]), few)
    simulated, predicted = changes(nominal, base, found, effect, target, SENSORS[text])
    assert np.linalg.norm(simulated) > 0.1
    assert np.abs(simulated - predicted).max() < 1e-9


@pytest.mark.parametrize("text", PHYSICS)
def test_predict_points_where_the_physics_goes(text, rig, few, base, nominal):
    effect, target = split(text)
    values, least = PHYSICS[text]
    found = statically(effect.inject(rig, target, values), few)
    assert len(found) > 0.8 * len(base)
    cosine, slope = agreement(*changes(nominal, base, found, effect, target, values))
    assert cosine > least
    assert 0.8 < slope < 1.2


@pytest.mark.parametrize("name", catalogue())
def test_nothing_is_predicted_of_no_effect(name, robot, base, nominal):
    effect, seen = catalogue()[name], see(base, nominal)
    target = effect.targets.of(robot, tuple(np.unique(base.placement).tolist()))[0]
    for grid in itertools.product(*(parameter.grid[:1] or (0.0,) for parameter in effect.parameters)):
        values = grid if effect.sizes else (2, 2)
        same = residuals(effect.predict(seen, target, values), nominal.value)
        assert np.abs(same - residuals(seen, nominal.value)).max() < 1e-12

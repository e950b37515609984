"""The catalogue: every effect's prediction against simulations with and without it."""

from __future__ import annotations

import dataclasses
import itertools

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from experiments.discovery.channels import ANCHORED, ROWS, residuals
from experiments.discovery.laboratory import exact_rig, measured_plan, simulated
from experiments.effects import catalogue
from experiments.effects.injection import passed
from experiments.effects.seen import see
from experiments.effects.targets import check_target, leg_links
from experiments.scenario import DEFAULT_PLAN, Scenario
from sim.errors import InputError
from sim.laboratory import run_experiment
from sim.measurements import Measurements, read_plan
from sim.model import CORNERS
from sim.prepared import prepare
from sim.rig import Rig, preset_rig, stages
from sim.scene import load_scene
from sim.static_laboratory import run_static

PLACEMENTS = 8
SEED = 103  # bounds were set on seed 1
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
    "backlash:left_hip_pitch": ((0.005,), 0.95),
    # Its load is what the sole's centre of pressure says, which the play itself brings towards zero.
    "backlash:left_ankle_roll": ((0.003,), 0.8),
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


DYNAMICS = {
    "lifted-corner:left_foot.front_left": ((0.0003,), 0.85),  # where a foot rocks, no load tells
    "joint-compliance:right_knee": ((0.0005,), 0.95),
    "tether-spring": ((20.0,), 0.95),
    "payload-step:torso": ((0.5, 0.7), 0.95),
}


def first(plan, count):
    """The first placements of a plan."""
    return plan.take(np.isin(plan.placement, np.unique(plan.placement)[:count]))


@pytest.fixture(scope="module")
def few(plan):
    return first(plan, PLACEMENTS)


@pytest.fixture(scope="module")
def rig(robot) -> Rig:
    rig = preset_rig("ideal", robot)
    return dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, repeats=2))


@pytest.fixture(scope="module")
def two(plan):
    return first(plan, 2)


@pytest.fixture(scope="module")
def plain(rig, two) -> Measurements:
    return statically(rig, two)


@pytest.fixture(scope="module")
def moved(rig, two):
    return run_experiment(rig, two, SEED)


@pytest.fixture(scope="module")
def base(rig, few) -> Measurements:
    return statically(rig, few)


def statically(rig, plan) -> Measurements:
    return run_static(prepare(rig, plan), [np.random.SeedSequence(1101)])[0].measurements


def split(text):
    name, _, target = text.partition(":")
    return catalogue()[name], target


def changes(nominal, base, with_it, effect, target, values, absorbed=True, physics=True):
    """What the simulation changed in the residuals and what is predicted, both (k, 11).

    Of the postures in both experiments; what base parameters (if `absorbed`) and a placement's constants
    absorb is taken out of both, as whoever looks for the effect does. Where it is `physics`, postures in
    which a board stands on three cells are left out: which these are, loads at its edge decide.
    """
    seen, before = see(with_it, nominal), see(base, nominal)
    rows = {key: k for k, key in enumerate(_keys(base))}
    here = np.array([k for k, key in enumerate(_keys(with_it)) if key in rows])
    if physics:
        there = np.array([rows[_keys(with_it)[k]] for k in here])
        twisted = np.abs(residuals(before, nominal.value)[there]) + np.abs(
            residuals(seen, nominal.value)[here]
        )
        here = here[twisted[:, ROWS["T"]].max(axis=1) < 1e-6]
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
        if absorbed:
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
    simulated, predicted = changes(nominal, base, found, effect, target, SENSORS[text], physics=False)
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


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
@pytest.mark.parametrize("text", SENSORS)
def test_predict_undoes_any_misreading(text, data, rig, robot, base, nominal):
    effect, _ = split(text)
    targets = effect.targets.of(robot, tuple(np.unique(base.placement).tolist()))
    target = data.draw(st.sampled_from(targets))
    values = tuple(
        data.draw(st.sampled_from(p.grid) if p.grid else st.floats(-3 * p.prior, 3 * p.prior))
        for p in effect.parameters
    )
    read = effect.inject(rig, target, values).misread
    assert read is not None
    cleaned = effect.predict(see(read(base), nominal), target, values)
    for name in ("joint_angles", "cell_forces", "plate_poses"):
        assert getattr(cleaned, name) == pytest.approx(getattr(base, name), abs=1e-9)


def zero(effect):
    """Values of an effect that is not there."""
    values = tuple((parameter.grid or (0.0,))[-1] for parameter in effect.parameters)
    return values if effect.sizes else (2, 2)


@pytest.mark.parametrize("name", catalogue())
def test_no_effect_predicts_nothing(name, robot, base, nominal):
    effect, seen = catalogue()[name], see(base, nominal)
    target = effect.targets.of(robot, tuple(np.unique(base.placement).tolist()))[0]
    same = residuals(effect.predict(seen, target, zero(effect)), nominal.value)
    assert np.abs(same - residuals(seen, nominal.value)).max() < 1e-12


@pytest.mark.parametrize(
    "name", sorted(set(catalogue()) - {"unsettled"})
)  # no time at all to settle is most of it
def test_no_effect_changes_nothing_in_the_laboratory(name, rig, robot, two, plain):
    effect = catalogue()[name]
    target = effect.targets.of(robot, tuple(np.unique(two.placement).tolist()))[-1]
    same = statically(effect.inject(rig, target, zero(effect)), two)
    assert plain.posture.tolist() == same.posture.tolist()
    for field in ("joint_angles", "cell_forces", "plate_poses"):
        assert getattr(same, field) == pytest.approx(getattr(plain, field), abs=1e-6)


@pytest.mark.parametrize("text", DYNAMICS)
def test_predict_points_where_the_full_dynamics_goes(text, rig, two, moved, nominal):
    effect, target = split(text)
    values, least = DYNAMICS[text]
    found = run_experiment(effect.inject(rig, target, values), two, SEED).measurements
    assert len(found) >= len(moved.measurements) - 2
    # Two placements have fewer equations than base parameters.
    cosine, slope = agreement(
        *changes(nominal, moved.measurements, found, effect, target, values, absorbed=False)
    )
    assert cosine > least
    assert 0.8 < slope < 1.2


def test_a_creeping_robot_stands_in_equilibrium(rig, two, nominal):
    """Read as soon as friction holds it, it shows in no channel (but for a placement's constants)."""
    short = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, window=2.0))
    found = run_experiment(catalogue()["unsettled"].inject(short, "", (0.5,)), two, SEED)
    assert max(held.settled_after for held in found.held) < 0.5
    left = residuals(see(found.measurements, nominal), nominal.value) / UNIT
    assert np.abs(left[:, : ANCHORED.start]).max() < 0.05  # mm, N, mrad


def test_loads_in_the_joints_are_what_the_servos_bear(moved, model, nominal):
    """But for dry friction: of the joint itself, and what it leaves of push between the feet."""
    torques = see(moved.measurements, nominal).torques
    servos = np.array([held.torques for held in moved.held])
    dry = np.array(
        [model.dof_frictionloss[model.joint(name).dofadr[0]] for name in moved.measurements.joints]
    )
    off = (servos + torques) / dry
    assert np.sqrt((off**2).mean()) < 1.0
    assert np.abs(off).max() < 3.0
    assert np.corrcoef(servos.ravel(), -torques.ravel())[0, 1] > 0.98


def test_a_rigid_payload_is_absorbed(rig, few, base, nominal):
    effect, values = catalogue()["payload"], (0.5, 0.05, 0.1, 0.3)
    found = statically(effect.inject(rig, "torso", values), few)
    simulated, predicted = changes(nominal, base, found, effect, "torso", values)
    raw, _ = changes(nominal, base, found, effect, "torso", values, absorbed=False)
    assert not predicted.any()
    assert np.abs(raw[:, ROWS["A"]]).max() > 1.0  # mm
    for channel, least in (("A", 1e-3), ("F", 1e-9), ("C", 1e-3)):  # mm, N, mrad
        assert np.abs(simulated[:, ROWS[channel]]).max() < least


def test_a_tilt_turns_about_x_then_about_y(rig):
    """A level table's leg shortened: gravity in the floor's axes."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0.0, 0.0, -1.0]
    edit = catalogue()["tilt"].inject(rig, "", (0.1, 0.2)).edit
    assert edit is not None
    edit(spec)
    a, b = 0.1, 0.2
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    assert (about_y @ about_x) @ spec.option.gravity == pytest.approx([0.0, 0.0, -1.0])


@pytest.mark.parametrize("name", ["random", "optimal"])
def test_the_nominal_laboratory_asked_again_shows_what_was_measured(name, robot, model, nominal):
    """Also where the plan has feed-forward, which the commands hold."""
    plan = first(read_plan(DEFAULT_PLAN.parent / name, robot, model), PLACEMENTS)
    run = run_static(prepare(preset_rig("wii", robot), plan), np.random.SeedSequence(SEED).spawn(1))[0]
    seen = see(run.measurements, nominal)
    again = simulated(exact_rig(seen), measured_plan(seen))
    assert len(again) == len(seen)
    assert np.abs(again.joint_angles - seen.joint_angles).max() < 5e-3
    feet = (again.cell_forces - seen.cell_forces).reshape(-1, 2, 4).sum(axis=2)
    assert np.abs(feet).max() < 15


@pytest.mark.parametrize(
    "text",
    [
        *("joint-compliance:right_knee", "backlash:right_hip_pitch", "tether", "sole-compliance"),
        "lifted-corner:left_foot.front_left",
    ],
)
def test_what_an_effect_adds_is_no_part_of_the_true_robot(text, rig, few, nominal):
    effect, target = split(text)
    values, _ = (PHYSICS | DYNAMICS | {"tether": ((1.0, 2.0), 0.0)})[text]
    truth = Scenario(effect.inject(rig, target, values), few, 1, "ideal").true_base_parameters()
    assert truth == pytest.approx(nominal.value, abs=1e-12)


def test_the_truth_is_of_the_robot_that_stood_there_first(rig, few, nominal):
    step = catalogue()["payload-step"].inject(rig, "torso", (1.0, 0.5))
    longer = catalogue()["link-length"].inject(step, "right_lower_leg", (0.01,))
    assert Scenario(step, few, 1, "ideal").true_base_parameters() == pytest.approx(nominal.value, abs=1e-12)
    assert np.abs(Scenario(longer, few, 1, "ideal").true_base_parameters() - nominal.value).max() > 1e-3


def test_what_is_changed_after_a_step_is_changed_before_and_after(rig):
    step = catalogue()["payload-step"]
    rig = step.inject(step.inject(rig, "torso", (1.0, 0.6)), "right_hip", (1.0, 0.3))
    rig = catalogue()["sole-compliance"].inject(rig, "", (1e-4,))
    assert [start for start, _ in stages(rig)] == [0.0, 0.3, 0.6]
    assert {one.compliance.sole_tilt for _, one in stages(rig)} == {1e-4}
    spec = load_scene(rig.robot)
    edit = stages(rig)[2][1].edit
    assert edit is not None
    edit(spec)
    plain = load_scene(rig.robot)
    for link in ("torso", "right_hip"):
        assert spec.body(link).mass == pytest.approx(plain.body(link).mass + 1.0)


def test_a_step_comes_at_its_part_of_the_recorded_time(rig, few, nominal):
    found = statically(catalogue()["payload-step"].inject(rig, "torso", (0.5, 0.41)), few)
    heavy = found.cell_forces.sum(axis=1) / found.gravity - nominal.mass
    assert heavy == pytest.approx(0.5 * (passed(found.time) >= 0.41), abs=1e-6)


def test_a_laboratory_does_not_change_before_it_begins(rig):
    for parts in ((0.0,), (1.5,)):
        with pytest.raises(InputError, match="expected more than 0 and at most 1"):
            stages(catalogue()["payload-step"].inject(rig, "torso", (0.5, *parts)))


@pytest.mark.parametrize("name", [name for name, effect in catalogue().items() if not effect.statics])
def test_statics_refuses_what_it_does_not_know(name, rig, robot, two):
    effect = catalogue()[name]
    target = effect.targets.of(robot, (1,))[0]
    with pytest.raises(InputError, match="static equilibrium"):
        prepare(effect.inject(rig, target, (0.001,)), two)


def test_links_whose_length_closes_the_legs(robot):
    names = ("hip", "upper_leg", "lower_leg", "ankle")
    assert set(leg_links(robot)) == {f"{side}_{name}" for side in ("right", "left") for name in names}


def test_cells_swap_by_their_corners():
    choices = catalogue()["swapped-cells"].parameters
    assert all(parameter.choices == CORNERS for parameter in choices)
    pairs = {frozenset(pair) for pair in itertools.product(*(p.grid for p in choices)) if len(set(pair)) == 2}
    assert len(pairs) == 6

"""Effects as they are written, corrected for twice or of another robot; a catalogue that nobody changes."""

import ast
import dataclasses
import pickle
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

import tulip_testbed as tt
from tests.test_refusals import rows
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import MOST_PRIORS, check_instance, effect_label, split_label
from tulip_testbed.effects.lasting import split_target
from tulip_testbed.effects.laws import LAW, law_effect
from tulip_testbed.effects.laws.grammar import says, sentence_of, sentences
from tulip_testbed.sim.robot import load_robot

PLACEMENTS = (1, 2, 30)


@cache
def tulip():
    """Load the robot once; a strategy has no fixtures."""
    return load_robot()


def value(parameter):
    """Any value that a parameter may have."""
    if parameter.choices:
        return st.sampled_from(range(len(parameter.choices))).map(float)
    if parameter.grid:
        return st.floats(min(parameter.grid), max(parameter.grid))
    most = MOST_PRIORS * parameter.prior
    return st.floats(0.0 if parameter.positive else -most, most)


@st.composite
def law_values(draw, parameters):
    """Sizes, ranges that end behind their beginning, and scales above zero."""
    values = [draw(st.floats(-1e-3, 1e-3)) for _ in parameters]
    for k, parameter in enumerate(parameters):
        if parameter.name.startswith("to"):
            values[k] = values[k - 1] + 1.0
        elif parameter.fixed and not parameter.name.startswith("from"):
            values[k] = draw(st.floats(1e-3, 1.0))
    return tuple(values)


@st.composite
def instances(draw, name):
    if name == LAW:
        target = str(draw(st.sampled_from(sentences(tulip()))))
        effect = law_effect(target)
        values = draw(law_values(effect.parameters))
    else:
        effect = catalogue()[name]
        target = draw(st.sampled_from(effect.targets.of(tulip(), PLACEMENTS)))
        values = tuple(draw(value(parameter)) for parameter in effect.parameters_on(target))
    chosen = [v for v, p in zip(values, effect.parameters, strict=True) if p.choices]
    if len(set(chosen)) < len(chosen):
        values = (0.0, 1.0)
    intervals = tuple(
        draw(st.none() | st.tuples(st.floats(-1e9, value), st.floats(value, 1e9))) for value in values
    )
    return tt.EffectInstance(effect, target, values, intervals if any(intervals) else ())


@pytest.mark.parametrize("name", [*catalogue(), *[LAW] * 6])
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_what_is_written_is_read_exactly(name, data):
    found, robot = data.draw(instances(name)), tulip()
    plain = tt.EffectInstance(found.effect, found.target, found.values)
    read = tt.EffectInstance.parse(str(found), robot, PLACEMENTS)
    assert read == plain
    assert str(read) == str(found)
    assert split_label(found.label) == (name, found.target)
    assert effect_label(*split_label(found.label)) == found.label == str(found).partition("=")[0]
    document = TypeAdapter(tt.EffectInstance)
    assert document.validate_json(document.dump_json(found)) == found
    copied = pickle.loads(pickle.dumps(found))
    assert copied == found
    assert copied.effect is read.effect is found.effect
    check_instance(found, robot, PLACEMENTS, "here")
    check_instance(found, robot, None, "here")
    assert name != LAW or "guess" in found.finding


@pytest.mark.parametrize(
    "name", ["left/knee", "left:knee", "left=knee", "left,knee", "a knee", "a%2F", "a@b"]
)
def test_a_joint_of_any_name_is_read_as_it_was_written(name, edited_tulip):
    robot = edited_tulip(*[f'tulip.xml: "left_knee" => "{name}"'] * 5)
    found = tt.EffectInstance.parse(f"encoder-offset:{name}=0.01", robot)
    assert (found.target, str(found)) == (name, f"encoder-offset:{name}=0.01")
    assert split_target(f"{name}@2") == (name, 2)
    laws = [law for law in sentences(robot) if name in (law.place, law.joint)]
    same = [law for law in sentences(tulip()) if "left_knee" in (law.place, law.joint)]
    assert len(laws) == len(same) > 100
    assert all(sentence_of(str(law)) == law and says(robot, law) for law in laws)


@rows("sentences")
def test_a_finding_is_a_sentence(robot, changes, words):
    text, *intervals = changes
    found = tt.EffectInstance.parse(text, robot)
    assert dataclasses.replace(found, intervals=tuple(map(ast.literal_eval, intervals))).finding == words


KNEE, ANKLE = "encoder-offset:right_knee=0.01", "encoder-offset:left_ankle_roll=0.002"


def test_corrections_of_different_readings_and_times_are_no_repetition(run, robot):
    with pytest.warns(tt.InputWarning, match="but the measurements show"):  # the robot has neither
        assert len(tt.identify(run, robot, corrections=[KNEE, ANKLE])) == 25
    slips = ["encoder-slip:right_knee=0.01,0.5", "encoder-slip:right_knee=0.01,0.7"]
    assert len(tt.Laboratory(robot).with_known(*slips).known) == 2


def test_a_joint_that_yields_in_two_places_yields_by_both(robot):
    """An ordinary laboratory, for instance, in which a joint yields more than usual."""
    one = "joint-compliance:right_knee"
    laboratory = tt.Laboratory(robot).with_effects(f"{one}=0.001").with_effects(f"{one}=0.003")
    runs = [
        lab.run(tt.plans.random.take(tt.plans.random.placement <= 1), 3, "statics").measurements
        for lab in (laboratory, tt.Laboratory(robot).with_effects(f"{one}=0.004"))
    ]
    assert runs[0].cell_forces == pytest.approx(runs[1].cell_forces, abs=1e-6)

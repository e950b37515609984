"""Held-out faults: each shows in a laboratory, in proportion to its amplitude, and has its answers."""

import dataclasses
import re

import numpy as np
import pytest

from tests.effect_changes import first, statically
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.targets import links
from tulip_testbed.experiments.benchmark.outside_faults import OUTSIDE
from tulip_testbed.experiments.benchmark.second_unseen_faults import ANSWERS as SECOND_ANSWERS
from tulip_testbed.experiments.benchmark.second_unseen_faults import SECOND
from tulip_testbed.experiments.benchmark.unseen_faults import ANSWERS as FIRST_ANSWERS
from tulip_testbed.experiments.benchmark.unseen_faults import UNSEEN
from tulip_testbed.measurements.cells import CELLS, PLATES
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import preset_rig, stages
from tulip_testbed.sim.robot import joint_names
from tulip_testbed.sim.scene import laboratory_scene
from tulip_testbed.sim.specs import compile_spec

HELD_OUT = UNSEEN + SECOND
ANSWERS = {**FIRST_ANSWERS, **SECOND_ANSWERS}
NUMBER = 3  # of a target at which every fault shows
COUNTS = {"joint": "njnt", "site": "nsite", "body": "nbody"}
SMALL = 1 / 16  # of the typical amplitude
OF = {
    *("nothing", "own-angle", "own-torque", "leg-load", "plate-load", "cop"),
    *("time", "time-since-loading", "posture-before", "direction"),
}


def without_friction(spec):
    for joint in spec.joints:
        joint.frictionloss = 0.0


@pytest.fixture(scope="module")
def exact(robot):
    """A laboratory in which nothing is random, so that an added hinge does not change any draw."""
    rig = edited(preset_rig("ideal", robot), without_friction)
    protocol = dataclasses.replace(rig.protocol, plate_sd=(0.0, 0.0, 0.0), repeats=0)
    controller = dataclasses.replace(rig.controller, command_sd=0.0)
    return dataclasses.replace(rig, protocol=protocol, controller=controller)


@pytest.fixture(scope="module")
def few(plan):
    return first(plan, 2)


@pytest.fixture(scope="module")
def plain(exact, few):
    return statically(exact, few)


@pytest.fixture(scope="module")
def readings(robot, few, exact, plain):
    """Return the function from a fault and an amplitude to what it changes, by posture, in s.d."""
    sheet = header_of(preset_rig("force-plate", robot)).sensors

    def table(m):
        parts = (
            m.joint_angles / sheet.encoder_sd,
            m.cell_forces / sheet.cell_sd,
            (m.plate_poses / np.array(sheet.placement_sd)).reshape(len(m), -1),
        )
        return dict(zip(m.posture.tolist(), np.column_stack(parts), strict=True))

    before = table(plain)

    def changes(fault, amplitude):
        rig = fault.inject(exact, NUMBER, amplitude)
        same_scene = rig.misread is not None  # a misreading changes no equilibrium
        after = table(rig.misread(plain) if same_scene else statically(rig, few))
        return {posture: row - before[posture] for posture, row in after.items() if posture in before}

    return changes


@pytest.mark.parametrize(("faults", "answers"), [(UNSEEN, FIRST_ANSWERS), (SECOND, SECOND_ANSWERS)])
def test_there_are_twelve_of_their_own(faults, answers):
    names = {fault.name for fault in faults}
    assert len(names) == 12
    others = {fault.name for fault in OUTSIDE + HELD_OUT if fault not in faults}
    assert not names & (others | set(catalogue()))
    assert all(fault.late and fault.amplitude > 0 for fault in faults)
    assert set(answers) == names


@pytest.mark.parametrize("fault", HELD_OUT, ids=lambda fault: fault.name)
def test_it_shows_in_proportion(fault, readings):
    shown = np.array(list(readings(fault, fault.amplitude).values()))
    assert np.sqrt((shown**2).mean(axis=0)).max() > 1  # of a reading's noise, over all postures
    once, twice = (readings(fault, part * fault.amplitude) for part in (SMALL, 2 * SMALL))
    both = sorted(once.keys() & twice.keys())
    assert len(both) > 5
    a, b = (np.array([each[posture] for posture in both]) for each in (once, twice))
    assert np.linalg.norm(b - 2 * a) < 0.15 * np.linalg.norm(b)
    if not fault.positive:
        other = readings(fault, -SMALL * fault.amplitude)
        both = sorted(once.keys() & other.keys())
        a, b = (np.array([each[posture] for posture in both]) for each in (once, other))
        assert np.linalg.norm(a + b) < 0.15 * np.linalg.norm(a)


@pytest.mark.parametrize("fault", HELD_OUT, ids=lambda fault: fault.name)
def test_without_amplitude_nothing_changes(fault, exact, plain):
    rig = fault.inject(exact, NUMBER, 0.0)
    assert (rig.edit, rig.later) == (exact.edit, exact.later)  # the same scene
    read = plain if rig.misread is None else rig.misread(plain)
    for name in ("joint_angles", "motor", "cell_forces", "plate_poses"):
        assert np.array_equal(getattr(read, name), getattr(plain, name))


def test_answers_are_in_the_agreed_words(robot):
    joints = set(joint_names(robot.model))
    known = {
        *(f"encoder:{joint}" for joint in joints),
        *(f"{what}:{plate}" for what in ("encoders", "cells", "plate") for plate in PLATES),
        *(f"cell:{cell}" for cell in CELLS),
        *(f"sole:{foot}" for foot in robot.feet),
        *(f"force:{link}" for link in links(robot)),
    }
    for answers in ANSWERS.values():
        for number in range(30):
            found = answers(robot, number)
            assert found
            for what, of in found:
                match = re.fullmatch(r"(?:angle|torque):(.+)", of)
                assert what in known
                assert match[1] in joints if match else of in OF


@pytest.mark.parametrize("number", [0, NUMBER, 7])
def test_what_is_misread_is_what_the_answers_name(number, exact, plain, robot):
    """Faults that only misread change the readings of their answers' targets and no others."""
    for fault in HELD_OUT:
        rig = fault.inject(exact, number, fault.amplitude)
        if rig.misread is None:
            continue
        read = rig.misread(plain)
        named = {what for what, _ in ANSWERS[fault.name](robot, number)}
        angles = (read.joint_angles != plain.joint_angles).any(axis=0)
        cells = (read.cell_forces != plain.cell_forces).any(axis=0)
        plates = (read.plate_poses != plain.plate_poses).any(axis=(0, 2))
        changed = {f"encoder:{j}" for j, wrong in zip(plain.joints, angles, strict=True) if wrong}
        changed |= {f"cell:{c}" for c, wrong in zip(CELLS, cells, strict=True) if wrong}
        changed |= {f"plate:{p}" for p, wrong in zip(PLATES, plates, strict=True) if wrong}
        of_groups = {
            **{f"encoders:{p}": {f"encoder:{j}" for j in plain.joints if j.startswith(p)} for p in PLATES},
            **{f"cells:{p}": {f"cell:{c}" for c in CELLS if c.startswith(p)} for p in PLATES},
        }
        assert changed
        assert any(changed <= of_groups.get(what, {what}) for what in named), fault.name


@pytest.mark.parametrize("number", [0, NUMBER, 7])
def test_what_is_built_in_is_where_the_answers_say(number, exact, robot):
    """Faults of the robot or its surroundings add springs, play or masses at their answers' targets alone."""
    before = built(exact)
    links_of = {f"encoder:{name}": robot.model.joint(name).bodyid[0] for name in joint_names(robot.model)}
    for fault in HELD_OUT:
        rig = fault.inject(exact, number, fault.amplitude)
        if rig.misread is not None:
            continue
        model = built(stages(rig)[-1][1])
        touched = {int(model.joint(j).bodyid[0]) for j in new(model, before, "joint")}
        touched |= {int(model.site(s).bodyid[0]) for s in new(model, before, "site")} - {0}
        added = set(new(model, before, "body"))
        for body in set(range(model.nbody)) - added:
            was, now = before.body(model.body(body).name), model.body(body)
            if not (np.array_equal(was.quat, now.quat) and np.isclose(was.mass, now.mass)):
                touched.add(body)
        names = {model.body(b if b not in added else int(model.body_parentid[b])).name for b in touched}
        named = {
            robot.model.body(links_of[what]).name if what in links_of else what.split(":")[1]
            for what, _ in ANSWERS[fault.name](robot, number)
        }
        assert names
        assert names <= named, fault.name


def built(rig):
    return compile_spec(laboratory_scene(rig, np.zeros((2, 3))), "scene")


def new(model, before, kind):
    """List the numbers of the joints, sites or bodies that a scene has and another one has not."""
    known = {getattr(before, kind)(k).name for k in range(getattr(before, COUNTS[kind]))}
    return [k for k in range(getattr(model, COUNTS[kind])) if getattr(model, kind)(k).name not in known]

"""Models that compile hugely, or not at all, or stand for no robot."""

from __future__ import annotations

from pathlib import Path

from tests.fuzz.cases import Expected, Rng, pick, refused, same
from tests.fuzz.robot_cases import PLATE, ROBOT, SCENE, insert, replaced, robot_mutation


@robot_mutation
def models_without_end(folder: Path, rng: Rng) -> Expected:
    """Small to write, too large to compile."""
    nest = "<replicate count='1000'>" * 4 + "<site/>" + "</replicate>" * 4
    section, text = pick(
        rng,
        [
            ("worldbody", nest),
            ("worldbody", "<replicate count='100000000'><site/></replicate>"),
            ("worldbody", "<flexcomp name='f' type='grid' count='400 400 400' spacing='.1 .1 .1' dim='3'/>"),
            ("asset", "<texture name='t' type='2d' builtin='flat' width='1000000' height='1000000'/>"),
            ("asset", "<hfield name='t' nrow='1000000' ncol='1000000' size='1 1 1 1'/>"),
            ("actuator", "</actuator><size nkey='2000000000'/><actuator>"),
            ("actuator", "</actuator><size memory='1000T'/><actuator>"),
            ("actuator", "</actuator><size nuserdata='2000000000'/><actuator>"),
            ("actuator", "</actuator><size nuser_body='2000000000'/><actuator>"),
            ("actuator", "</actuator><custom><numeric name='n' size='2000000000'/></custom><actuator>"),
            ("sensor", "<user name='u' dim='2000000000'/>"),
            ("worldbody", "".join(f"<body name='b{k}'><geom size='1'/></body>" for k in range(5_000))),
        ],
    )
    insert(folder, section, text)
    return refused(ROBOT)


@robot_mutation
def robots_that_cannot_be(folder: Path, rng: Rng) -> Expected:
    old, new = pick(
        rng,
        [
            ('mass="10.7"', 'mass="-10.7"'),
            ('mass="10.7"', 'mass="0"'),
            ('mass="10.7"', 'mass="1e9"'),
            ('diaginertia="0.25 0.23 0.075"', 'diaginertia="0 0 0"'),
            ('diaginertia="0.25 0.23 0.075"', 'diaginertia="1 1 100"'),
            ('<freejoint name="torso"/>', ""),
            ('<freejoint name="torso"/>', '<joint name="torso" axis="0 0 1"/>'),
            ('<joint name="left_knee" class', '<joint name="left_knee" type="slide" class'),
            ('<joint name="left_knee" class', '<joint name="left_knee" type="ball" class'),
            ('name="left_knee" class', 'name="right_knee" class'),
            ('<joint name="left_knee" class', "<joint class"),
            ('<body name="left_hip">', '<body name="right_hip">'),
            ('<body name="left_hip">', "<body>"),
            ('timestep="0.001"', 'timestep="0"'),
            ('timestep="0.001"', 'timestep="-1"'),
            ('timestep="0.001"', 'timestep="1e-12"'),
            ('timestep="0.001"', 'timestep="0.001" gravity="0 0 9.81"'),
            ('timestep="0.001"', 'timestep="0.001" gravity="0 0 0"'),
            ('timestep="0.001"', 'timestep="0.001" gravity="1 0 -9.81"'),
            ('timestep="0.001"', 'timestep="0.001" gravity="0 0 -1e300"'),
            ('name="right_foot_front_left"', 'name="toe"'),
            ('class="sole" pos="0.13 0.05 -0.058"', 'class="sole" pos="0.13 0.05 -0.05"'),
            ('<body name="torso" pos="0 0 0.6899">', '<body name="torso" pos="0 0 1e200">'),
            ('axis="0 0 1" range="-40 40"', 'axis="0 0 0" range="-40 40"'),
            ('range="-40 40"', 'range="40 -40"'),
            ('<body name="right_ankle" pos="0 0 -0.2732">', '<body name="right_ankle" quat="0 0 0 0">'),
            ("<actuator>", '<keyframe><key name="stand" qpos="1 2"/></keyframe><actuator>'),
        ],
    )
    replaced(folder / ROBOT, old, new, 1)
    return (
        refused()
        if "quat" not in new and "key" not in new and "1 1 100" not in new
        else Expected("either", ())
    )


@robot_mutation
def scenes_that_cannot_be(folder: Path, rng: Rng) -> Expected:
    """The robot alone is fine, so that only what works on the plates is refused."""
    name, old, new = pick(
        rng,
        [
            (SCENE, 'name="floor" type', 'name="ground" type'),
            (SCENE, '<frame name="right_plate_place"', '<frame name="here"'),
            (SCENE, 'prefix="left_"', 'prefix="other_"'),
            (SCENE, '<include file="tulip.xml"/>', ""),
            (SCENE, "<default>", '<option timestep="0.5"/><default>'),
            (SCENE, "<default>", '<option gravity="0 0 9"/><default>'),
            (
                SCENE,
                '<model name="plate" file="plate.xml"/>',
                '<model name="plate" file="scene_plates.xml"/>',
            ),
            (PLATE, 'name="plate_top"', 'name="top"'),
            (PLATE, '<touch name="plate_front_left"', '<touch name="front"'),
            (PLATE, '<touch name="plate_front_left"', '<force name="plate_front_left"'),
            (PLATE, 'mass="3.5"', 'mass="-3.5"'),
            (PLATE, '<site name="plate_front_left"', '<site name="front"'),
        ],
    )
    replaced(folder / name, old, new, 1)
    return refused("scene")


@robot_mutation
def drives_that_cannot_be(folder: Path, rng: Rng) -> Expected:
    old, new = pick(
        rng,
        [
            ('<motor name="left_knee" joint="left_knee" class="drive_90w_111"/>', ""),
            ('joint="left_knee" class="drive_90w_111"/>', 'joint="right_knee" class="drive_90w_111"/>'),
            ('joint="left_knee" class="drive_90w_111"/>', 'body="left_foot"/>'),
            ('ctrlrange="-25.4 25.4" forcerange="-25.4 25.4"', ""),
            ('forcerange="-25.4 25.4"', 'forcerange="-25.4 0"'),
        ],
    )
    replaced(folder / ROBOT, old, new, 1)
    return refused()


@robot_mutation
def torque_limits_given_otherwise(folder: Path, rng: Rng) -> Expected:
    """A motor's control range limits its torque as well as a force range does."""
    given = pick(rng, ('ctrlrange="-25.4 25.4"', 'forcerange="-25.4 25.4"'))
    replaced(folder / ROBOT, given, "", 1)
    return same()

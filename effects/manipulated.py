"""A manipulated laboratory: devices at other places, a cable removed, a known mass on the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, look_up, shortened
from tulip_testbed.effects.arranged import arranged, check_everywhere
from tulip_testbed.effects.catalogue.payload import add_mass
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.targets import links
from tulip_testbed.measurements.manipulations import Experiment, needs_cells
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import joint_names

SURVEYED = ("plate-translation", "plate-yaw")


def manipulated(rig: Rig, experiment: Experiment) -> Rig:
    """Return a laboratory with the known masses of an experiment on its robot."""
    masses = experiment.arrangement.masses
    if not masses:
        return rig

    def edit(spec: mujoco.MjSpec) -> None:
        for one in masses:
            add_mass(spec, one.link, one.mass, np.array(one.place))

    return edited(rig, edit)


def as_manipulated(instances: Sequence[EffectInstance], experiment: Experiment) -> tuple[EffectInstance, ...]:
    """Return effects as they act in a manipulated laboratory.

    Instruments that were zeroed, tared or surveyed again are exact.
    """
    state, out = experiment.arrangement, []
    for one in instances:
        name = one.effect.name
        check_everywhere(one.target, str(one))
        anew = (
            (name == "encoder-offset" and one.target in state.zeroed)
            or (name == "cell-tare" and state.tared)
            or (name in SURVEYED and state.moved)
        )
        act = None if anew else arranged(one.effect, one.target, one.values, experiment)
        if act is not None:
            out.append(replace(one, target=act[0], values=act[1], intervals=()))
    return tuple(out)


def check_experiment(rig: Rig, experiment: Experiment) -> None:
    """Refuse manipulations that a laboratory cannot have.

    Raises:
        InputError: names the manipulation, and what is valid.
    """
    header, state = header_of(rig), experiment.arrangement
    for text in experiment.manipulations:
        if header.contacts is not None and needs_cells(text):
            raise InputError(
                f"manipulations: found '{shortened(text)}' with wrench sensors, expected plates on cells"
            )
    for joint in state.zeroed:
        look_up("joint", joint, joint_names(rig.robot.model), "manipulations: encoder re-zeroed")
    for one in state.masses:
        look_up("link", one.link, links(rig.robot), "manipulations: known mass")

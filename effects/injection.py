"""Change a laboratory: its scene, its readings, from when on, and the known masses on its robot."""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, look_up, shortened
from tulip_testbed.effects.targets import links
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.manipulations import Experiment, needs_cells
from tulip_testbed.sim.procedure import header_of, new_set_up
from tulip_testbed.sim.rig import Rig, stages
from tulip_testbed.sim.robot import joint_names, quaternion, rotation_matrices
from tulip_testbed.sim.scene import laboratory_scene
from tulip_testbed.sim.specs import compile_spec

STARTS = tuple(k / 10 for k in range(1, 10))  # fractions of the experiment's time that a search tries


def misreading(rig: Rig, read: Callable[[Measurements], Measurements]) -> Rig:
    """Return a laboratory whose readings also pass through `read`, after all earlier misreadings."""
    before = rig.misread
    return replace(rig, misread=read if before is None else lambda m: read(before(m)))


def edited(rig: Rig, edit: Callable[[mujoco.MjSpec], None]) -> Rig:
    """Return a laboratory whose scene is also changed by `edit`, during the whole experiment."""
    return always(rig, lambda one: _edited(one, edit))


def always(rig: Rig, change: Callable[[Rig], Rig]) -> Rig:
    """Return a laboratory changed during the whole experiment, its later stages included."""
    changed = change(rig)
    if rig.later is None:
        return changed
    start, then = rig.later
    return replace(changed, later=(start, always(then, change)))


def from_then_on(rig: Rig, start: float, change: Callable[[Rig], Rig]) -> Rig:
    """Return a laboratory changed from this fraction of the experiment's time on."""
    if rig.later is None or start < rig.later[0]:
        return replace(rig, later=(start, always(rig, change)))
    next_start, then = rig.later
    return replace(rig, later=(next_start, from_then_on(then, start, change)))


def _edited(rig: Rig, edit: Callable[[mujoco.MjSpec], None]) -> Rig:
    before = rig.edit
    if before is None:
        return replace(rig, edit=edit)

    def both(spec: mujoco.MjSpec) -> None:
        before(spec)
        edit(spec)

    return replace(rig, edit=both)


def check_built(rig: Rig) -> None:
    """Refuse a laboratory that MuJoCo cannot compile, for instance one with a negative mass."""
    for _, stage in stages(rig):
        compile_spec(laboratory_scene(stage, np.zeros((2, 3))), str(rig.robot.path))


def add_mass(spec: mujoco.MjSpec, link: str, mass: float, place: np.ndarray) -> None:
    """Add a point mass at a place in a link's frame, (3,) [m], to its mass, centre of mass and inertia."""
    model = compile_spec(spec.copy(), spec.modelname)
    body = model.body(link)
    center, before = body.ipos.copy(), float(body.mass[0])
    joined = (before * center + mass * place) / (before + mass)
    (axes,) = rotation_matrices(body.iquat[None])
    inertia = axes @ np.diag(body.inertia) @ axes.T
    for part, at in ((before, center), (mass, place)):
        arm = at - joined
        inertia = inertia + part * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
    principal, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    edit = spec.body(link)
    edit.explicitinertial = True
    edit.mass, edit.ipos, edit.iquat, edit.inertia = before + mass, joined, quaternion(axes), principal
    edit.fullinertia = np.full(6, np.nan)


def manipulated(rig: Rig, experiment: Experiment) -> Rig:
    """Return a laboratory with the known masses of an experiment on its robot."""
    masses = experiment.arrangement.masses
    if not masses:
        return rig

    def edit(spec: mujoco.MjSpec) -> None:
        for one in masses:
            add_mass(spec, one.link, one.mass, np.array(one.place))

    return edited(rig, edit)


def check_experiment(rig: Rig, experiment: Experiment) -> None:
    """Refuse manipulations that a laboratory cannot have."""
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


def indicator(names: tuple[str, ...], name: str) -> np.ndarray:
    """Return which of the names is `name`, (len(names),) bool."""
    return np.arange(len(names)) == names.index(name)


def successive(m: Measurements) -> list[tuple[int, int]]:
    """Return pairs of rows that follow each other in one set-up, in the order of time."""
    order = np.argsort(m.time, kind="stable")
    anew = new_set_up(m.placement[order], m.support[order])
    return [
        (int(previous), int(row))
        for previous, row, apart in zip(order[:-1], order[1:], anew, strict=True)
        if not apart
    ]

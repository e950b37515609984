"""How effects change a rig: instruments after one another, edits of the scene after one another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from tulip_testbed.sim.measurements import Measurements
from tulip_testbed.sim.rig import Rig, stages
from tulip_testbed.sim.robot import compile_spec
from tulip_testbed.sim.scene import laboratory_scene

STARTS = tuple(k / 10 for k in range(1, 10))  # parts of the experiment's time that a search tries


def misreading(rig: Rig, read: Callable[[Measurements], Measurements]) -> Rig:
    """A rig whose readings pass through `read` too."""
    before = rig.misread
    return replace(rig, misread=read if before is None else lambda m: read(before(m)))


def edited(rig: Rig, edit: Callable[[mujoco.MjSpec], None]) -> Rig:
    """A rig whose scene is changed by `edit` too, at any time of the experiment."""
    return always(rig, lambda one: _edited(one, edit))


def always(rig: Rig, change: Callable[[Rig], Rig]) -> Rig:
    """A rig changed, and so what stands there later."""
    changed = change(rig)
    if rig.later is None:
        return changed
    start, then = rig.later
    return replace(changed, later=(start, always(then, change)))


def from_then_on(rig: Rig, part: float, change: Callable[[Rig], Rig]) -> Rig:
    """A rig that is changed from this part of the experiment's time on."""
    if rig.later is None or part < rig.later[0]:
        return replace(rig, later=(part, always(rig, change)))
    start, then = rig.later
    return replace(rig, later=(start, from_then_on(then, part, change)))


def _edited(rig: Rig, edit: Callable[[mujoco.MjSpec], None]) -> Rig:
    before = rig.edit
    if before is None:
        return replace(rig, edit=edit)

    def both(spec: mujoco.MjSpec) -> None:
        before(spec)
        edit(spec)

    return replace(rig, edit=both)


def check_built(rig: Rig) -> None:
    """Refuse a laboratory that MuJoCo cannot build: nobody takes more from a link than its mass.

    Raises:
        InputError: what the compiler says.
    """
    for _, stage in stages(rig):
        compile_spec(laboratory_scene(stage, np.zeros((2, 3))), str(rig.robot.path))


def column(names: tuple[str, ...], name: str, size: int) -> np.ndarray:
    """Zeros but for a one where `name` is, (size,)."""
    return np.arange(size) == names.index(name)

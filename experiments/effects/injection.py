"""How effects change a rig: instruments after one another, edits of the scene after one another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from sim.measurements import Measurements
from sim.rig import Rig


def misreading(rig: Rig, read: Callable[[Measurements], Measurements]) -> Rig:
    """A rig whose readings pass through `read` too."""
    before = rig.misread
    return replace(rig, misread=read if before is None else lambda m: read(before(m)))


def edited(rig: Rig, edit: Callable[[mujoco.MjSpec], None]) -> Rig:
    """A rig whose scene is changed by `edit` too."""
    before = rig.edit
    if before is None:
        return replace(rig, edit=edit)

    def both(spec: mujoco.MjSpec) -> None:
        before(spec)
        edit(spec)

    return replace(rig, edit=both)


def column(names: tuple[str, ...], name: str, size: int) -> np.ndarray:
    """Zeros but for a one where `name` is, (size,)."""
    return np.arange(size) == names.index(name)


def passed(time: np.ndarray) -> np.ndarray:
    """Time as a part of the experiment's, 0 at its first posture and 1 at its last, (m,)."""
    span = float(np.ptp(time))
    return (time - time.min()) / span if span > 0 else np.zeros(len(time))

"""A mass bolted to a link: the link's mass, centre of mass and inertia with it."""

from __future__ import annotations

import mujoco
import numpy as np

from tulip_testbed.sim.robot import compile_spec


def add_mass(spec: mujoco.MjSpec, link: str, mass: float, place: np.ndarray | None) -> None:
    """Add a point mass to a link.

    Args:
        place: in the link's frame, (3,) [m]; None: at its centre of mass.
    """
    model = compile_spec(spec.copy(), spec.modelname)
    body = model.body(link)
    center, before = body.ipos.copy(), float(body.mass[0])
    there = center if place is None else np.asarray(place)
    joined = (before * center + mass * there) / (before + mass)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    axes = turn.reshape(3, 3)
    inertia = axes @ np.diag(body.inertia) @ axes.T
    for part, at in ((before, center), (mass, there)):
        arm = at - joined
        inertia = inertia + part * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
    principal, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    edit = spec.body(link)
    edit.explicitinertial = True
    edit.mass, edit.ipos, edit.iquat, edit.inertia = before + mass, joined, quaternion, principal
    edit.fullinertia = np.full(6, np.nan)

"""Read the mechanism from a laboratory's scene, compiled with everything that the rig changes."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.sim.drives import motor_joint
from tulip_testbed.sim.dynamics.stiction import BREAKAWAY, sliding_friction
from tulip_testbed.sim.model_check import check_features
from tulip_testbed.sim.plates import plate_geometry, short_feet
from tulip_testbed.sim.rig import Rig
from tulip_testbed.sim.robot import Robot, joint_names, rotation_matrices, sole_corners, sole_point
from tulip_testbed.sim.scene import laboratory_scene
from tulip_testbed.sim.specs import compile_spec
from tulip_testbed.sim.statics.mechanism import HINGE, SLIDE, Body, Joint, Mechanism, Rope, rocking_board
from tulip_testbed.sim.statics.soft_constraints import board_compliance, contact_compliance, stops_of

LEVEL = 1e-6  # m, largest difference in height of a sole's corners


def read_mechanism(rig: Rig) -> Mechanism:
    if not np.isfinite(rig.protocol.speed_gate):
        raise InputError(
            "static equilibrium: found a robot read before it is at rest (speed_gate inf), expected a finite "
            "gate; use the full dynamics"
        )
    spec = laboratory_scene(rig, np.zeros((2, 3)))
    model = compile_spec(spec, str(rig.robot.path))
    check_features(model, "static equilibrium")
    _check_soles(model, rig.robot.feet)
    tree = _tree(model)
    springs, ropes = _tendons(tree)
    heights = [plate_geometry(spec, plate).top_height for plate in PLATES]
    return Mechanism(
        **_bodies(tree),
        **_coordinates(tree),
        **_servos(tree, joint_names(rig.robot.model)),
        **_feet(tree, rig.robot),
        **_plates(model, rig.compliance.cell),
        gravity=model.opt.gravity.copy(),
        springs=springs,
        ropes=ropes,
        top_height=float(heights[0] if np.ptp(heights) == 0 else np.nan),
    )


def _check_soles(model: mujoco.MjModel, feet: tuple[str, str]) -> None:
    """Refuse a foot whose sole corners are not level."""
    for foot in feet:
        heights = [model.geom(f"{foot}_{corner}").pos[2] for corner in CORNERS]
        if (gap := np.ptp(heights)) > LEVEL:
            raise InputError(
                f"static equilibrium: foot '{foot}': found sole corners at heights that differ by "
                f"{1e3 * gap:.3g} mm, expected one height; such a foot rocks: use the full dynamics"
            )


@dataclass(frozen=True)
class _Tree:
    """The robot's part of a compiled scene: numbers of bodies and coordinates by those in the scene."""

    model: mujoco.MjModel
    number: dict[int, int]
    column: dict[int, int]

    @property
    def turning(self) -> list[int]:
        """List the joints in the order of their coordinates."""
        return list(self.column)


def _tree(model: mujoco.MjModel) -> _Tree:
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0]
    root = int(model.jnt_bodyid[free])
    members = [b for b in range(1, model.nbody) if model.body_rootid[b] == root]
    number = {body: k for k, body in enumerate(members)}
    turning = [j for j in range(model.njnt) if model.jnt_bodyid[j] in number and j != free]
    odd = [model.joint(j).name for j in turning if model.jnt_type[j] not in (HINGE, SLIDE)]
    if odd:
        raise InputError(f"static equilibrium: found joints {listed(odd)} that are neither hinge nor slide")
    return _Tree(model, number, {j: k for k, j in enumerate(turning)})


def _bodies(tree: _Tree) -> dict[str, Any]:
    model, members = tree.model, list(tree.number)
    return {
        "bodies": tuple(_body(tree, body) for body in members),
        "mass": model.body_mass[members].copy(),
        "center": model.body_ipos[members].copy(),
    }


def _body(tree: _Tree, body: int) -> Body:
    model = tree.model
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    joints = [
        Joint(
            tree.column[j],
            int(model.jnt_type[j]),
            model.jnt_axis[j].copy(),
            model.jnt_pos[j].copy(),
            float(model.qpos0[model.jnt_qposadr[j]]),
        )
        for j in range(first, first + count)
        if j in tree.column
    ]
    return Body(
        name=model.body(body).name,
        parent=tree.number.get(int(model.body_parentid[body]), -1),
        position=model.body_pos[body].copy(),
        rotation=rotation_matrices(model.body_quat[[body]])[0],
        joints=tuple(joints),
    )


def _coordinates(tree: _Tree) -> dict[str, Any]:
    """Return springs, dry friction and limits in single coordinates."""
    model, turning = tree.model, tree.turning
    dofs = np.array([model.jnt_dofadr[j] for j in turning])
    return {
        "names": tuple(model.joint(j).name for j in turning),
        "stiffness": model.jnt_stiffness[turning].reshape(len(turning), -1)[:, 0].copy(),
        "rest": np.array([model.qpos_spring[model.jnt_qposadr[j]] for j in turning]),
        "friction": model.dof_frictionloss[dofs].copy(),
        "stops": stops_of(model, turning, dofs),
    }


def _servos(tree: _Tree, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the robot's joints in the plan's order, and the servos that turn them."""
    model = tree.model
    motors = [model.joint(motor_joint(model, name)).id for name in names]
    servos = [next(i for i in range(model.nu) if model.actuator_trnid[i, 0] == motor) for motor in motors]
    return {
        "joints": np.array([tree.column[model.joint(name).id] for name in names]),
        "motors": np.array([tree.column[motor] for motor in motors]),
        "gain": model.actuator_gainprm[servos, 0].copy(),
        "limit": model.actuator_forcerange[servos, 1].copy(),
    }


def _feet(tree: _Tree, robot: Robot) -> dict[str, Any]:
    """Return the soles, and their contact with the boards."""
    model, nominal = tree.model, robot.model
    feet = [model.body(foot).id for foot in robot.feet]
    soles = [int(model.geom(f"{foot}_{CORNERS[0]}").bodyid[0]) for foot in robot.feet]
    corners = np.array([sole_corners(nominal, foot)[:, :2] for foot in robot.feet])
    # A sole is its foot or a body below it.
    points = [
        sole_point(nominal, name) - (model.body_pos[sole] if sole != foot else 0.0)
        for name, foot, sole in zip(robot.feet, feet, soles, strict=True)
    ]
    plates = [model.body(f"{plate}_plate").id for plate in PLATES]
    compliance = [
        contact_compliance(model, f"{foot}_{CORNERS[0]}", f"{plate}_plate_top")
        for foot, plate in zip(robot.feet, PLATES, strict=True)
    ]
    return {
        "feet": tuple(tree.number[foot] for foot in feet),
        "soles": tuple(tree.number[sole] for sole in soles),
        "sole_points": np.array(points),
        "corners": corners,
        "sole_friction": np.array(
            [BREAKAWAY * sliding_friction(model, pair) for pair in zip(soles, plates, strict=True)]
        ),
        "sole_compliance": np.array(list(map(board_compliance, corners, compliance))),
    }


def _plates(model: mujoco.MjModel, cell_compliance: float) -> dict[str, Any]:
    """Return the boards on their cells, of this compliance each [m/N]."""
    plates = [model.body(f"{plate}_plate").id for plate in PLATES]
    sites = [[model.site(f"{plate}_plate_{corner}").id for corner in CORNERS] for plate in PLATES]
    cells = np.array([[_on_plate(model, s, p) for s in row] for row, p in zip(sites, plates, strict=True)])
    feet = [contact_compliance(model, f"{plate}_plate_{CORNERS[0]}", None) for plate in PLATES]
    boards = zip(cells, feet, strict=True)
    return {
        "cells": cells,
        "plate_weight": np.array([-model.body_subtreemass[p] * model.opt.gravity[2] / 4 for p in plates]),
        "board_compliance": np.array([board_compliance(c, cell_compliance + foot) for c, foot in boards]),
        "rocking": tuple(map(rocking_board, cells, short_feet(model))),
    }


def _tendons(tree: _Tree) -> tuple[tuple, tuple[Rope, ...]]:
    """Return fixed tendons with springs, and spatial tendons from the robot to the world as ropes."""
    model, springs, ropes = tree.model, [], []
    for t in range(model.ntendon):
        name, stiffness = model.tendon(t).name, float(np.ravel(model.tendon_stiffness[t])[0])
        low, high = (float(x) for x in model.tendon_lengthspring[t])
        first, count = int(model.tendon_adr[t]), int(model.tendon_num[t])
        kinds = model.wrap_type[first : first + count]
        objects, coefficients = model.wrap_objid[first : first + count], model.wrap_prm[first : first + count]
        if (kinds == mujoco.mjtWrap.mjWRAP_JOINT).all():
            row = np.zeros(len(tree.column))
            for j, c in zip(objects, coefficients, strict=True):
                row[tree.column[int(j)]] = c
            springs.append((stiffness, (low, high), row))
            continue
        bodies = (
            model.site_bodyid[objects] if (kinds == mujoco.mjtWrap.mjWRAP_SITE).all() and count == 2 else []
        )
        inside = [k for k, b in enumerate(bodies) if int(b) in tree.number]
        outside = [k for k, b in enumerate(bodies) if int(b) == 0]
        if len(inside) != 1 or len(outside) != 1:
            raise InputError(
                f"static equilibrium: tendon '{name}': "
                "expected joints, or one site on the robot and one in the world"
            )
        site, anchor = int(objects[inside[0]]), int(objects[outside[0]])
        ropes.append(
            Rope(
                tree.number[int(model.site_bodyid[site])],
                model.site_pos[site].copy(),
                model.site_pos[anchor].copy(),
                stiffness,
                (low, high),
            )
        )
    return tuple(springs), tuple(ropes)


def _on_plate(model: mujoco.MjModel, site: int, plate: int) -> np.ndarray:
    body = int(model.site_bodyid[site])
    place = model.site_pos[site] if body == plate else model.body_pos[body] + model.site_pos[site]
    return place[:2]

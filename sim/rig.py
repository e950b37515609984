"""The rig: robot, controller, sensors, protocol and hooks, as the simulators take them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, look_up
from tulip_testbed.measurements import Measurements
from tulip_testbed.sim.compliance import Compliance
from tulip_testbed.sim.control import Controller
from tulip_testbed.sim.drives import Drives
from tulip_testbed.sim.robot import Robot, load_robot
from tulip_testbed.sim.sensors import PLATE, PRESETS, Sensors


@dataclass(frozen=True)
class Protocol:
    """Procedure of a placement.

    Attributes:
        move_time: time to move from one posture to the next, feet clamped [s].
        rest_time: time to come to rest before the clamps are released [s].
        hold_time: time for which a posture is held [s]; the averaged window is at its end.
        window: length of the averaged window [s].
        placement_time: time to lift the robot and set up the next placement [s].
        speed_gate: a control period is calm if all joints and the torso are slower than this [rad/s, m/s].
        calm_time: the robot is at rest after this time of calm periods [s]; then dry friction sticks.
        force_gate: the posture is accepted if no cell's force varies by more than this in 0.2 s [N].
        gated: average over 0.1 s once the posture is accepted, since nothing changes any more; otherwise
            hold to the end and average over the window.
        slip_limit: largest distance of a foot from its mark; beyond it the foot has slipped [m].
        tilt_limit: largest lean of the torso beyond the planned one; beyond it the robot has tipped [rad].
        lift_limit: largest height of a sole corner or a cell over its ground; beyond it it is lifted [m].
        plate_sd: s.d. of a plate's true pose about the intended one [m, m, rad].
        plate_gap: gap between the two boards' long edges [m].
        repeats: number of postures that are measured twice.
    """

    move_time: float = 2.0
    rest_time: float = 1.0
    hold_time: float = 60.0
    window: float = 30.0
    placement_time: float = 120.0
    speed_gate: float = 2e-5
    force_gate: float = 3e-4
    calm_time: float = 0.5
    gated: bool = True
    slip_limit: float = 1e-4
    tilt_limit: float = 0.2
    lift_limit: float = 2e-5
    plate_sd: tuple[float, float, float] = (0.003, 0.003, 0.005)
    plate_gap: float = 0.01
    repeats: int = 10


@dataclass(frozen=True)
class Rig:
    """A virtual laboratory as the simulators take it.

    Attributes:
        robot: the nominal robot.
        sensors, controller, drives, compliance, protocol: see these classes.
        edit: change of the scene, by name, before it is compiled, so that the true robot or the physics
            differ from the nominal model.
        misread: map from correct to faulty measurements, for instrument faults beyond noise.
        side_forces: parts that a plate's cells, all together, read of its horizontal force on the foot, along
            x and y of the plate, (2, 2).
        floor: how far the floor yields to the load, see `soft_floor.gravity_on` [rad/(N m)].
        later: start, as a fraction of the time between first and last posture, and the rig that replaces
            this one from then on; instruments and protocol stay this one's.
    """

    robot: Robot = field(default_factory=load_robot)
    sensors: Sensors = field(default_factory=Sensors)
    controller: Controller = field(default_factory=Controller)
    drives: Drives = field(default_factory=Drives)
    compliance: Compliance = field(default_factory=Compliance)
    protocol: Protocol = field(default_factory=Protocol)
    edit: Callable[[mujoco.MjSpec], None] | None = None
    misread: Callable[[Measurements], Measurements] | None = None
    side_forces: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    floor: tuple[float, float] = (0.0, 0.0)
    later: tuple[float, Rig] | None = None

    @property
    def wrenches_at(self) -> str:
        """Return where readings need the ground's wrenches: a place of wrench sensors, or "" nowhere."""
        if self.sensors.wrench is not None:
            return self.sensors.wrench.place
        return PLATE if np.any(self.side_forces) else ""


def stages(rig: Rig) -> list[tuple[float, Rig]]:
    """List the rigs that follow each other, each with its start as a fraction of the experiment's time."""
    found, start = [(0.0, replace(rig, later=None))], 0.0
    while rig.later is not None:
        before, (start, rig) = start, rig.later
        if not before < start <= 1:
            raise InputError(
                f"laboratory: found a change at {start:g} of the experiment's time, "
                f"expected more than {before:g} and at most 1"
            )
        found.append((start, replace(rig, later=None)))
    return found


def preset_rig(name: str, robot: Robot | None = None) -> Rig:
    """Return the default rig with a sensor preset; drives and compliance are those of the description."""
    look_up("preset", name, PRESETS, "sensors")
    robot = robot or load_robot()
    drives = Drives(**_table(robot, "drives", Drives))
    if drives.backlash > 0 and drives.wind_up <= 0:
        raise InputError(
            f"{robot.path}: [drives]: found backlash = {drives.backlash:g} and no wind_up, expected both"
        )
    return Rig(
        robot=robot,
        sensors=PRESETS[name],
        drives=drives,
        compliance=Compliance(**_table(robot, "compliance", Compliance)),
    )


def _table(robot: Robot, name: str, kind: type) -> dict[str, float]:
    """Return a table of the robot's description as arguments of a dataclass of numbers."""
    where, table = f"{robot.path}: [{name}]", robot.settings.get(name, {})
    if not isinstance(table, dict):
        raise InputError(f"{where}: found {table!r}, expected a table")
    for key, value in table.items():
        look_up("key", key, [field.name for field in fields(kind)], where)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < np.inf:
            raise InputError(f"{where}: key '{key}': found {value!r}, expected a number, 0 or more")
    return table

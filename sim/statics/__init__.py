"""Static equilibrium of robot, servos, feet and plates, solved directly and in batches."""

from tulip_testbed.sim.statics.approach import approach_displacements, friction_at_rest, sway_displacements
from tulip_testbed.sim.statics.forces import (
    Load,
    State,
    residual,
    servo_torques,
    sole_poses,
)
from tulip_testbed.sim.statics.mechanism import Mechanism, mechanism
from tulip_testbed.sim.statics.sensed_wrenches import foot_wrenches, plate_wrenches, sole_wrenches
from tulip_testbed.sim.statics.solve import (
    Reference,
    cell_forces,
    faults,
    solve_by_chord,
    solve_by_newton,
    solve_near,
)

__all__ = [
    "Load",
    "Mechanism",
    "Reference",
    "State",
    "approach_displacements",
    "cell_forces",
    "faults",
    "foot_wrenches",
    "friction_at_rest",
    "mechanism",
    "plate_wrenches",
    "residual",
    "servo_torques",
    "sole_poses",
    "sole_wrenches",
    "solve_by_chord",
    "solve_by_newton",
    "solve_near",
    "sway_displacements",
]

"""The static equilibrium of robot, servos, feet and plates, solved directly and in batches."""

from tulip_testbed.sim.statics.approach import left_friction, swaying, ways
from tulip_testbed.sim.statics.forces import Load, State, residual, soles, torques
from tulip_testbed.sim.statics.mechanism import Mechanism, mechanism
from tulip_testbed.sim.statics.solve import Reference, cell_forces, faults, reference, solve

__all__ = [
    "Load",
    "Mechanism",
    "Reference",
    "State",
    "cell_forces",
    "faults",
    "left_friction",
    "mechanism",
    "reference",
    "residual",
    "soles",
    "solve",
    "swaying",
    "torques",
    "ways",
]

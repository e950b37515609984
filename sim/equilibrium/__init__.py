"""The static equilibrium of robot, servos, feet and plates, solved directly and in batches."""

from sim.equilibrium.approach import left_friction, swaying, ways
from sim.equilibrium.mechanism import Mechanism, mechanism
from sim.equilibrium.reading import cell_forces, faults
from sim.equilibrium.solve import Reference, reference, solve
from sim.equilibrium.statics import Load, State, residual, soles, torques

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

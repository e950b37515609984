"""The functions that a researcher calls; `tulip_testbed` offers them all by name.

Every function uses one thread for linear algebra, so that a notebook and the command line give the same bits.
"""

from tulip_testbed.api.inputs import (
    describe_robot,
    import_table,
    load_robot,
    read_measurements,
    write_measurements,
)
from tulip_testbed.api.measured import check, discover, export_model, identify, next_experiment, predict
from tulip_testbed.api.planned import (
    atlas,
    describe_plan,
    draw_plan,
    list_effects,
    optimize_plan,
    protocol,
    tolerance,
    watch,
)
from tulip_testbed.api.shown import report, view
from tulip_testbed.api.simulated import monte_carlo, simulate, validate
from tulip_testbed.base.errors import InputError
from tulip_testbed.experiments.laboratory import Laboratory

__all__ = [
    "InputError",
    "Laboratory",
    "atlas",
    "check",
    "describe_plan",
    "describe_robot",
    "discover",
    "draw_plan",
    "export_model",
    "identify",
    "import_table",
    "list_effects",
    "load_robot",
    "monte_carlo",
    "next_experiment",
    "optimize_plan",
    "predict",
    "protocol",
    "read_measurements",
    "report",
    "simulate",
    "tolerance",
    "validate",
    "view",
    "watch",
    "write_measurements",
]

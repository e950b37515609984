"""Study the static identification of humanoid robots in a virtual laboratory.

    import tulip_testbed as tt

    robot = tt.load_robot()
    lab = tt.Laboratory(robot, sensors="force-plate")
    run = lab.run(tt.plans.random, seed=3)
    fit = tt.identify(run.measurements, robot)

A name is loaded when it is first used: `import tulip_testbed` alone loads neither NumPy nor a simulator.
"""

from importlib import import_module

FUNCTIONS = (
    *(
        "load_robot",
        "describe_robot",
        "read_measurements",
        "write_measurements",
        "identify",
        "Laboratory",
        "discover",
    ),
    *(
        "simulate",
        "validate",
        "monte_carlo",
        "next_experiment",
        "draw_plan",
        "describe_plan",
        "optimize_plan",
        "protocol",
        "check",
        "watch",
        "import_table",
        "predict",
        "export_model",
        "atlas",
        "tolerance",
        "list_effects",
        "view",
        "report",
        "InputError",
    ),
)
MODULES = ("effects", "plans")

__all__ = [
    *FUNCTIONS,
    *MODULES,
]


def __getattr__(name: str) -> object:
    if name in FUNCTIONS:
        return getattr(import_module(f"{__name__}.api"), name)
    if name in MODULES:
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; valid: {', '.join(__all__)}")


def __dir__() -> list[str]:
    return list(__all__)

"""Study the static identification of humanoid robots in a virtual laboratory.

    import tulip_testbed as tt

    robot = tt.load_robot()
    lab = tt.Laboratory(robot, sensors="force-plate")
    run = lab.run(tt.plans.random, seed=3)
    fit = tt.identify(run.measurements, robot)

A name is loaded when it is first used: `import tulip_testbed` alone loads neither NumPy nor a simulator.
"""

import lazy_loader

# The names are those of `__init__.pyi`, which type checkers and editors read too.
_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name in __all__:
        return _load(name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}; valid: {', '.join(__all__)}")

"""Settings of a scene that replace those of the robot's file: solver, options, defaults, contacts."""

from __future__ import annotations

import mujoco

from tulip_testbed.base.errors import InputError

TIMESTEP = 0.001  # s
# With MuJoCo's default of 1e-8 the solver stops early, so that forces fluctuate and feet creep faster.
SOLVER_TOLERANCE = 1e-12
SOLVER = (
    *("solver", "jacobian", "iterations", "ls_iterations", "ls_tolerance"),
    *("noslip_iterations", "noslip_tolerance", "ccd_iterations", "ccd_tolerance"),
)
OPTIONS = (
    *SOLVER,
    *("impratio", "density", "viscosity", "magnetic", "wind", "disableflags", "enableflags"),
)
SIZES = ("memory", "njmax", "nconmax")
# Defaults of elements that the laboratory adds to a robot's scene.
LIMITS = ("limited", "range", "margin", "actfrclimited", "actfrcrange", "solref_limit", "solimp_limit")
FRICTION = ("frictionloss", "solref_friction", "solimp_friction")
DEFAULTS = {
    "geom": (
        *("condim", "priority", "friction", "solmix", "solref", "solimp"),
        *("margin", "gap", "adhesion", "surfacevel"),
    ),
    "pair": ("condim", "friction", "solref", "solreffriction", "solimp", "margin", "gap"),
    "equality": ("solref", "solimp"),
    "joint": (
        *("pos", "axis", "ref", "springref", "springdamper", "stiffness", "damping", "armature"),
        *("actgravcomp", *LIMITS, *FRICTION),
    ),
    "tendon": ("stiffness", "springlength", "damping", "armature", *LIMITS, *FRICTION),
}


def set_solver(spec: mujoco.MjSpec) -> None:
    """Set how MuJoCo solves for the constraint forces in any scene of the laboratory."""
    _copy(SOLVER, mujoco.MjSpec().option, spec.option)
    spec.option.tolerance = SOLVER_TOLERANCE


def make_plain(spec: mujoco.MjSpec) -> None:
    """Make a robot's file a scene of the laboratory: its options, sizes, defaults and contacts.

    Gravity stays the robot's; so do all values that its elements took from its defaults.
    """
    plain = mujoco.MjSpec()
    _copy(OPTIONS, plain.option, spec.option)
    _copy(SIZES, plain, spec)
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    for kind, names in DEFAULTS.items():
        _copy(names, getattr(plain.default, kind), getattr(spec.default, kind))
    for contact in [*spec.pairs, *spec.excludes]:
        spec.delete(contact)


def check_pairs(model: mujoco.MjModel, robot: str, soles: list[str], where: str) -> None:
    """Refuse contact pairs of the robot other than those of its sole corners with something else.

    Such a contact would bear forces that no plate reads.

    Args:
        model: a scene. robot: name of its free body. soles: names of the sole corners.

    Raises:
        InputError: names the pair and its geoms.
    """
    root = model.body(robot).id
    for k in range(model.npair):
        geoms = [int(model.pair_geom1[k]), int(model.pair_geom2[k])]
        own = [model.geom(g).name for g in geoms if model.body_rootid[model.geom_bodyid[g]] == root]
        if len(own) > 1 or any(name not in soles for name in own):
            names = " and ".join(f"'{model.geom(g).name}'" for g in geoms)
            raise InputError(
                f"{where}: <contact>: found a pair of {names}, expected the robot in pairs of a sole corner "
                "and its board alone: remove it"
            )


def _copy(names: tuple[str, ...], source: object, target: object) -> None:
    for name in names:
        setattr(target, name, getattr(source, name))

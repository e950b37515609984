"""Requirements on a robot beyond an MJCF that compiles, and features that the laboratory does not have.

Such features put forces on a robot at rest: the full dynamics would act on them, while the static equilibrium
and the regressor would not.
"""

from collections.abc import Iterator

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed, shortened

MOST_BODIES = 100
MOST_LENGTH = 20.0  # m, from a body to the next or to its centre of mass
LEAST_MASS, MOST_MASS = 0.01, 1e4  # kg, of the whole robot
LEAST_GRAVITY, MOST_GRAVITY = 0.1, 100.0  # m/s2
LEAST_STEP, MOST_STEP = 1e-5, 0.01  # s
# Flags without an effect on a robot at rest; all others switch physics off or replace it.
HARMLESS_OFF = (
    *("warmstart", "filterparent", "eulerdamp", "autoreset", "nativeccd", "multiccd", "island", "midphase"),
)
HARMLESS_ON = ("energy", "fwdinv", "invdiscrete")


def check_model(model: mujoco.MjModel, where: str) -> None:
    """Refuse a model of the robot alone that cannot be simulated or identified."""
    if model.nbody - 1 > MOST_BODIES:
        raise InputError(f"{where}: found {model.nbody - 1} bodies, expected at most {MOST_BODIES}")
    for kind, count in (("body", model.nbody), ("joint", model.njnt)):
        names = [getattr(model, kind)(i).name for i in range(count)]
        if "" in names:
            raise InputError(
                f"{where}: found a {kind} without a name (the {names.index('') + 1}. in the file)"
            )
        for name in names:  # an effect from experiment 2 on is written left_knee@2
            if not name.isprintable() or (name.rpartition("@")[2].isdecimal() and "@" in name):
                raise InputError(
                    f"{where}: found a {kind} named {shortened(repr(name))}, expected printable characters "
                    "and no '@' with a number at the end"
                )
    free = mujoco.mjtJoint.mjJNT_FREE
    roots = np.flatnonzero(model.body_parentid[1:] == 0) + 1
    if len(roots) != 1 or model.jnt_type[model.jnt_bodyid == roots[0]].tolist() != [free]:
        found = listed(model.body(i).name for i in roots) or "none"
        raise InputError(f"{where}: found root bodies {found}; expected one root body on a free joint")
    if not (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE).any():
        raise InputError(f"{where}: found no hinge joint, expected at least one")
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    joints = [model.joint(i).name for i in range(model.njnt)]
    for quantity, values, names in (
        ("position", model.body_pos[1:], bodies),
        ("centre of mass", model.body_ipos[1:], bodies),
        ("position", model.jnt_pos, joints),
    ):
        _within(where, names, quantity, np.abs(values).max(axis=1), 0.0, MOST_LENGTH, "m")
    mass = model.body_mass[1:]
    _within(where, bodies, "mass", mass, 0.0, MOST_MASS, "kg")
    _within(where, [bodies[0]], "mass of the whole robot", mass.sum()[None], LEAST_MASS, MOST_MASS, "kg")
    for i in np.flatnonzero(model.actuator_trntype != mujoco.mjtTrn.mjTRN_JOINT).tolist():
        kind = mujoco.mjtTrn(model.actuator_trntype[i]).name.removeprefix("mjTRN_").lower()
        raise InputError(
            f"{where}: actuator '{model.actuator(i).name}': found one that acts on a {kind}, expected a joint"
        )
    check_options(model, where)
    check_features(model, where)


def check_options(model: mujoco.MjModel, where: str) -> None:
    """Refuse a gravity that is not vertical or out of range, and a time step out of range."""
    *aside, up = model.opt.gravity
    if any(aside) or not LEAST_GRAVITY <= -up <= MOST_GRAVITY:
        raise InputError(
            f"{where}: <option gravity>: found {listed(model.opt.gravity)}, "
            f"expected 0 0 -g with g within [{LEAST_GRAVITY:g}, {MOST_GRAVITY:g}] m/s2"
        )
    _within(where, ["<option>"], "timestep", np.array([model.opt.timestep]), LEAST_STEP, MOST_STEP, "s")


def check_before_compiling(spec: mujoco.MjSpec, where: str) -> None:
    """Refuse what the compiled model no longer shows: limits out of order, a prescribed total mass.

    MuJoCo would leave a joint whose limits are not in order without any.
    """
    if spec.compiler.settotalmass > 0:  # in a scene, it would be that of the robot and of the plates
        raise InputError(
            f"{where}: <compiler>: found settotalmass {spec.compiler.settotalmass:g}, expected none; "
            "scale the masses of the bodies"
        )
    for joint in spec.joints:
        low, high = joint.range
        given = joint.limited != mujoco.mjtLimited.mjLIMITED_FALSE and (low, high) != (0.0, 0.0)
        if given and not low < high:
            raise InputError(
                f"{where}: joint '{joint.name}': found range [{low:g}, {high:g}], expected low < high"
            )


def _within(
    where: str, names: list[str], quantity: str, values: np.ndarray, low: float, high: float, unit: str
) -> None:
    wrong = ~((values >= low) & (values <= high))
    if wrong.any():
        k = int(wrong.argmax())
        raise InputError(
            f"{where}: '{names[k]}': {quantity}: found {values[k]:g}, expected [{low:g}, {high:g}] {unit}"
        )


def check_features(model: mujoco.MjModel, where: str) -> None:
    """Refuse a model with a feature that acts in the full dynamics alone.

    It is a robot alone, or a scene without the laboratory's own clamps.
    """
    for found, expected in _unknown_features(model):
        raise InputError(f"{where}: found {found}, expected {expected}")


def _unknown_features(model: mujoco.MjModel) -> Iterator[tuple[str, str]]:
    """Yield what is found and what is expected."""
    option = model.opt
    for state, flags, prefix, harmless, word in (
        (option.disableflags, mujoco.mjtDisableBit, "mjDSBL_", HARMLESS_OFF, "disabled"),
        (option.enableflags, mujoco.mjtEnableBit, "mjENBL_", HARMLESS_ON, "enabled"),
    ):
        names = [name for name in flags.__members__ if name.startswith(prefix)]
        chosen = [n.removeprefix(prefix).lower() for n in names if state & flags.__members__[n].value]
        if odd := [name for name in chosen if name not in harmless]:
            yield f"<option><flag> {listed(odd)} {word}", "MuJoCo's default"
    if option.disableactuator:
        yield "actuator groups that <option> disables", "none"
    if (option.density or option.viscosity) and option.wind.any():
        yield f"<option wind> {listed(option.wind)}", "no wind in a medium"
    if model.nplugin or model.nflex:
        yield "plugins or flexible bodies", "rigid bodies alone"
    if len(floating := np.flatnonzero(model.body_gravcomp)):
        yield f"gravcomp in body '{model.body(floating[0]).name}'", "none: a body has all its weight"
    if model.neq:
        kind = mujoco.mjtEq(int(model.eq_type[0])).name.removeprefix("mjEQ_").lower()
        name = model.equality(0).name
        yield f"<equality> {kind}{f' {name!r}' if name else ''}", "no constraint but joints"
    yield from _unknown_joints(model)
    yield from _unknown_tendons(model)


def _unknown_joints(model: mujoco.MjModel) -> Iterator[tuple[str, str]]:
    for j in range(model.njnt):
        name = model.joint(j).name
        if np.any(model.jnt_stiffnesspoly[j]):
            yield f"a stiffness of more than one number in joint '{name}'", "one number"
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
            first = int(model.jnt_dofadr[j])
            for word, value in (
                ("stiffness", np.ravel(model.jnt_stiffness[j])[0]),
                ("frictionloss", model.dof_frictionloss[first : first + 6].max()),
            ):
                if value:
                    yield f"{word} {value:g} in the free joint '{name}'", "none: the root is free"


def _unknown_tendons(model: mujoco.MjModel) -> Iterator[tuple[str, str]]:
    for t in range(model.ntendon):
        words = (
            ("a limited range", model.tendon_limited[t]),
            ("frictionloss", model.tendon_frictionloss[t]),
            ("a stiffness of more than one number", np.any(model.tendon_stiffnesspoly[t])),
        )
        for word, there in words:
            if there:
                yield f"{word} in tendon '{model.tendon(t).name}'", "a spring, or none"

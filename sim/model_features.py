"""Features of MJCF that put forces on a robot at rest and that the laboratory does not have.

The full dynamics would act on them, while the static equilibrium and the regressor would not.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError, listed

# Flags without an effect on a robot at rest; all others switch physics off or replace it.
HARMLESS_OFF = (
    *("warmstart", "filterparent", "eulerdamp", "autoreset", "nativeccd", "multiccd", "island", "midphase"),
)
HARMLESS_ON = ("energy", "fwdinv", "invdiscrete")


def check_features(model: mujoco.MjModel, where: str) -> None:
    """Refuse a model with a feature that acts in the full dynamics alone.

    Args:
        model: a robot alone, or a scene without the laboratory's own clamps.

    Raises:
        InputError: names the feature and the element that has it.
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

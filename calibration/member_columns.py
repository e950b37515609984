"""How the residuals change with the members of the families and with the sizes of effects."""

import numpy as np

from tulip_testbed.calibration.families import Family
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import SIZE, VARYING, fields, packed, residuals, unpacked

STEP = 1e-2  # of an effect's plausible size, of the difference quotient


def member_columns(
    observed: Observation, theta: np.ndarray, sensitivity: np.ndarray, family: Family | FreeEffect
) -> np.ndarray:
    """Differentiate the residuals by every number of a family, or size of an effect, (m, 11, n) per SI unit.

    Members are small: the derivative is that at zero. That of an effect is taken at its size, because a play,
    for example, changes the less the larger it is.

    Args:
        observed: readings with little noise, from which members and effects are removed as far as they are
            known.
        theta: base parameters, (p,) [m].
        sensitivity: derivative of the residuals by the fields of `packed`, (m, 11, k).
    """
    if isinstance(family, FreeEffect):
        without = _removed(observed, family.start)
        observed = unpacked(observed, 2 * packed(observed) - packed(without)).changed(
            tree=observed.tree, cells=observed.cells
        )
        before = _removed(observed, family.start)
    else:
        before = observed
    sizes = STEP * family.steps
    out = np.zeros((len(observed), SIZE, len(sizes)))
    moved = dict[str, list[tuple[int, np.ndarray]]]()
    before_all, plain = {name: getattr(before, name) for name in VARYING}, None
    for number, size in enumerate(sizes.tolist()):
        after = _removed(observed, family.single(number, size))
        if after.tree is before.tree and after.cells is before.cells:
            for name, first in before_all.items():
                if (second := getattr(after, name)) is not first:
                    moved.setdefault(name, []).append((number, second - first))
        else:
            plain = residuals(before, theta) if plain is None else plain
            out[..., number] = (plain - residuals(after, theta)) / size
    for name, at in zip(VARYING, fields(before).values(), strict=True):
        if name in moved:
            by = np.zeros((len(observed), at.stop - at.start, len(sizes)))
            for number, change in moved[name]:
                by[..., number] = change.reshape(by.shape[:2])
            out -= sensitivity[..., at] @ (by / sizes)
    return out


def _removed(observed: Observation, instance: EffectInstance) -> Observation:
    return instance.effect.remove(observed, instance.target, instance.values)

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
    changes, linear = np.zeros((len(sizes), len(observed), sensitivity.shape[2])), []
    before_all, places = [getattr(before, name) for name in VARYING], list(fields(before).values())
    changed = np.zeros(sensitivity.shape[2], bool)
    plain: np.ndarray | None = None
    for number, size in enumerate(sizes.tolist()):
        after = _removed(observed, family.single(number, size))
        if after.tree is before.tree and after.cells is before.cells:
            linear.append(number)
            for name, first, at in zip(VARYING, before_all, places, strict=True):
                if (second := getattr(after, name)) is not first:
                    changes[number, :, at] = (second - first).reshape(len(first), -1)
                    changed[at] = True
        else:
            plain = residuals(before, theta) if plain is None else plain
            out[..., number] = (plain - residuals(after, theta)) / size
    if linear:
        by = np.compress(changed, changes[linear], axis=2).transpose(1, 2, 0)
        out[..., linear] = -(np.compress(changed, sensitivity, axis=2) @ by) / sizes[linear]
    return out


def _removed(observed: Observation, instance: EffectInstance) -> Observation:
    return instance.effect.remove(observed, instance.target, instance.values)

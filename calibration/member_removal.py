"""Readings without the members of the families and the effects, with the loads of the estimated robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tulip_testbed.calibration.estimated_loads import with_estimated_loads
from tulip_testbed.calibration.free_effect import FreeEffect
from tulip_testbed.calibration.linearisation import OF_LOADS, Families, joint_compliance, split_members
from tulip_testbed.effects.instance import EffectInstance, removed
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import difference, moved_by, packed, unpacked


def members_removed(
    observed: Observation,
    families: Families,
    phi: np.ndarray,
    theta: np.ndarray,
    covariance: np.ndarray,
    errors: np.ndarray | None = None,
) -> Observation:
    """Remove members and effects, with the loads of the estimated robot.

    How much an effect changes is computed from readings with little noise, because otherwise the noise would
    follow the residuals, and a play would rest at the wrong end. Compliances are removed as the cells show
    the loads; the covariance of the residuals contains what follows from their noise.

    Args:
        errors: noise of the readings as far as it is known, (m, k) as in `packed`.
    """
    compliance = joint_compliance(families, phi, observed.tree.joints)
    loaded = with_estimated_loads(observed, theta, covariance, compliance)
    every = instances_of_members(families, phi)
    sized = [one for one in every if one.effect.sizes]
    # Exchanged readings are undone as they are, and first: they are the last to act.
    loaded = removed(loaded, [one for one in every if not one.effect.sizes])
    free = [
        instance
        for family, values in split_members(families, phi)
        if isinstance(family, FreeEffect) and len(family) and family.name not in OF_LOADS
        for instance in family.instances(values)
    ]
    if not free or errors is None:
        return _removed(loaded, sized)
    others = [instance for instance in sized if instance not in free]
    smooth = unpacked(loaded, packed(loaded) - errors)
    return moved_by(_removed(loaded, others), _removed(smooth, others), _removed(smooth, sized))


def _removed(observed: Observation, instances: Sequence[EffectInstance]) -> Observation:
    """Remove effects; compliances last, and together, since the loads hardly depend on them."""
    yielding = [one for one in instances if one.effect.name in OF_LOADS]
    rest = removed(observed, [one for one in instances if one.effect.name not in OF_LOADS])
    if not yielding:
        return rest
    change = sum(difference(rest, removed(rest, [one])) for one in yielding)
    return unpacked(rest, packed(rest) + change)


def instances_of_members(families: Families, phi: np.ndarray) -> list[EffectInstance]:
    return [
        instance for family, values in split_members(families, phi) for instance in family.instances(values)
    ]

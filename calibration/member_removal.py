"""Readings without the members of the families and the effects, with the loads of the estimated robot.

Gravity's torques depend on the base parameters alone. A joint that yields is a softer servo: the closed legs
share their internal forces by the compliances of servos and joints in series.

An observation computes loads from standard parameters. Here they are the robot's own model, corrected by the
estimated base parameters: their mean given the estimate, if the model's masses are uncertain by 20 % and its
centres of mass by 20 mm. Where the data determine the base parameters, torques are theirs; elsewhere the
model's.
"""

from dataclasses import replace

import numpy as np

from tulip_testbed.calibration.linearisation import Families, joint_compliance, split_members
from tulip_testbed.effects.instance import OF_LOADS, misread_in_feet, removed, removed_at
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.identification.cad_prior import CENTER_SD, MASS_SD
from tulip_testbed.identification.observation import Observation
from tulip_testbed.identification.residual_channels import moved_by, packed, unpacked

SCALE_SD = 1e-3  # relative, of the total mass, which is weighed


def members_removed(
    observed: Observation,
    families: Families,
    phi: np.ndarray,
    theta: np.ndarray,
    covariance: np.ndarray,
    errors: np.ndarray | None = None,
) -> Observation:
    """Remove members and effects, with the loads of the estimated robot.

    How much an effect changes is computed from readings with little noise. Otherwise gains would shrink the
    noise, which the evidence would take for a better fit, and a play would rest at the wrong end. Compliances
    are removed as the cells show the loads; the covariance of the residuals contains what follows from their
    noise.

    Args:
        errors: noise of the readings as far as it is known, (m, k) as in `packed`.
    """
    compliance = joint_compliance(families, phi, observed.tree.joints)
    loaded = with_estimated_loads(observed, theta, covariance, compliance)
    every = [
        instance for family, values in split_members(families, phi) for instance in family.instances(values)
    ]
    sized = [instance for instance in every if instance.effect.sizes]
    # Exchanged readings are undone as they are, and first: they are the last to act.
    loaded = removed(loaded, [instance for instance in every if not instance.effect.sizes])
    smooth = None if errors is None else unpacked(loaded, packed(loaded) - errors)
    # Compliances come last, and together, since the loads hardly depend on them.
    yielding = [instance for instance in sized if instance.effect.name in OF_LOADS]
    others = [instance for instance in sized if instance.effect.name not in OF_LOADS]
    out = rest = removed_at(smooth, loaded, others)
    for instance in yielding:
        out = moved_by(out, rest, removed(rest, [instance]))
    return misread_in_feet(loaded, others, rest, out, smooth)


def with_estimated_loads(
    observed: Observation, theta: np.ndarray, covariance: np.ndarray, compliance: np.ndarray
) -> Observation:
    """Return the observation with the loads of the estimated robot.

    Args:
        theta: base parameters, (p,) [m].
        covariance: of theta, (p, p) [m2].
        compliance: of the joints between encoder and link, (n_joints,) [rad/Nm].
    """
    stiffness = 1 / (1 / observed.servo_gain + np.maximum(compliance, 0.0))
    model = standard_parameters(observed.nominal.robot.model)
    mass = model[:, 0]
    total = observed.weight / observed.measurements.gravity
    model = model * (total / mass.sum())
    mass = model[:, 0]
    # A mass moves its centre's moment with it.
    spread = np.zeros((*model.shape, 4))
    spread[:, :, 0] = MASS_SD * model
    for axis in (1, 2, 3):
        spread[:, axis, axis] = CENTER_SD * mass
    n = len(model)
    prior = np.zeros((n, 4, n, 4))
    each = np.arange(n)
    prior[each, :, each, :] = spread @ spread.mT
    prior = prior.reshape(4 * n, 4 * n)
    seen = np.vstack([observed.nominal.parameters.from_standard / total, np.tile([1.0, 0, 0, 0], n)])
    noise = np.zeros((len(seen), len(seen)))
    noise[:-1, :-1] = covariance
    noise[-1, -1] = (SCALE_SD * total) ** 2
    innovation = np.append(theta, total) - seen @ model.ravel()
    gain = np.linalg.solve(seen @ prior @ seen.T + noise, innovation)
    standard = model + (prior @ seen.T @ gain).reshape(-1, 4)
    return replace(observed, standard=standard, servo_stiffness=stiffness)

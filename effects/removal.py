"""Remove effects from measurements, for an identification that knows the nominal laboratory only."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tulip_testbed.base.errors import InputError, shortened, warn
from tulip_testbed.effects.instance import EffectInstance, check_instance, removed
from tulip_testbed.effects.laws.grammar import LAW, sentence_of
from tulip_testbed.effects.laws.misread import quantity, readings, split_values
from tulip_testbed.identification.ballast import known_weight
from tulip_testbed.identification.kinematics import turned_about
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.observation import Observation, observe, turned
from tulip_testbed.identification.residual_channels import carried, center
from tulip_testbed.measurements import Measurements

SLACK = 0.02  # of a range, by which noise may leave it
MOST_NUMBERS = 12  # of postures in a warning


def corrected(observed: Observation) -> Measurements:
    """Return measurements that would show the observation in the nominal laboratory.

    A shift of the centre of pressure that the cells do not explain (`shift`, a tilted stance foot) becomes
    the same shift of both plates. A vertical force other than the weight (`lift`) is taken off all cells in
    proportion, which leaves the centre of pressure where it is. Link lengths that differ from the nominal
    ones remain in `observed.tree`.
    """
    if observed.measurements.contacts is not None:
        return _corrected_wrenches(observed)
    forces = carried(observed)
    total = forces.sum(axis=1)
    plain = (forces[..., None] * observed.cell_places).sum(axis=1) / total[:, None]
    poses = observed.plate_poses.copy()
    poses[:, :, :2] += (_center(observed) - plain)[:, None]
    share = np.where(forces != 0, (1 - _lift(observed) / total)[:, None], 1.0)
    return replace(
        observed.measurements,
        joint_angles=observed.joint_angles,
        cell_forces=observed.cell_forces * share,
        plate_poses=poses,
        cells=observed.cells,
    )


def _center(observed: Observation) -> np.ndarray:
    """Return the centre of pressure in the base frame, known masses included, (m, 2) [m]."""
    own, ballast = center(observed), observed.ballast
    return (own if ballast is None else ballast.together(own)) + observed.geometry.stance_sole[:, :2]


def _lift(observed: Observation) -> np.ndarray:
    """Return the vertical force in addition to the weight of robot and known masses, (m,) [N]."""
    return observed.lift - known_weight(observed.measurements)


def _corrected_wrenches(observed: Observation) -> Measurements:
    """Return what `corrected` does with wrench sensors, in which shift and tilt become moments."""
    m, contacts, found = observed.measurements, observed.measurements.contacts, observed.contacts
    assert contacts is not None
    assert found.by_channel is not None
    assert m.wrenches is not None
    forces = carried(observed)
    total = forces @ found.bears.ravel()
    down = (forces.reshape(len(observed), 2, -1) * found.bears).sum(axis=2)
    # The force on the foot is scaled; the sensor's zero and what hangs below it are not.
    share = np.where(forces != 0, (1 - _lift(observed) / total)[:, None], 1.0)
    change = (observed.cell_forces * share - found.values).reshape(len(observed), 2, -1)
    wrenches = m.wrenches + change @ found.by_reading.T
    moments = (forces[..., None] * observed.cell_places).sum(axis=1)
    plain = moments / (observed.weight + observed.lift)[:, None]
    shift = turned(-observed.contact_poses[..., 2], (_center(observed) - plain)[:, None])
    moment = np.stack([shift[..., 1], -shift[..., 0], np.zeros_like(down)], axis=-1) * down[..., None]
    for side in (0, 1):
        own = moment[:, side] @ turned_about(contacts.pose[side, 3:])
        for k, name in enumerate(("mx", "my", "mz")):
            if name in contacts.channels:
                wrenches[:, side, contacts.channels.index(name)] += own[:, k]
    return replace(
        m,
        joint_angles=observed.joint_angles,
        wrenches=wrenches,
        plate_poses=observed.plate_poses,
    )


def without(
    measurements: Measurements, nominal: Nominal, instances: Sequence[EffectInstance]
) -> tuple[Measurements, Observation]:
    """Return the measurements with these effects removed, and the observation from which they come.

    A warning names the postures at which a law would have to extrapolate.

    Raises:
        InputError: an effect on something that these measurements do not have, such as a placement; a law in
            several experiments together.
    """
    placements = np.unique(measurements.placement).tolist()
    for instance in instances:
        check_instance(instance, nominal.robot, placements, f"correction {instance.label}")
        if measurements.experiments and instance.effect.name == LAW:
            raise InputError(
                f"correction {instance.label}: found {len(measurements.experiments)} experiments together, "
                "expected one: a law speaks of places in one laboratory"
            )
    before = observe(measurements, nominal)
    for one in instances:
        if len(numbers := beyond_range(before, one)):
            shown = ", ".join(map(str, numbers[:MOST_NUMBERS]))
            more = f" and {len(numbers) - MOST_NUMBERS} more" if len(numbers) > MOST_NUMBERS else ""
            word = "postures" if len(numbers) > 1 else "posture"
            warn(
                f"{shortened(one.label)}: {word} {shown}{more} outside the range in which the law was "
                "learned; there it is held at its value at the range's end: do not trust it there"
            )
    observed = removed(before, instances)
    return corrected(observed), observed


def beyond_range(observed: Observation, instance: EffectInstance) -> list[int]:
    """Return the numbers of the postures at which a law that has a range would have to extrapolate."""
    if instance.effect.name != LAW:
        return []
    sentence = sentence_of(instance.target)
    _, _, ends = split_values(sentence, instance.values)
    low, high = ends[0::2], ends[1::2]
    slack, out = SLACK * (high - low), np.zeros(len(observed), bool)
    for at in readings(observed, sentence) if len(ends) else ():
        x = quantity(observed, sentence, at)
        out |= ((x < low - slack) | (x > high + slack)).any(axis=1)
    return np.unique(observed.measurements.posture[out]).tolist()

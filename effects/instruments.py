"""Which effects an experiment can have, by the contact sensors with which it was measured."""

from __future__ import annotations

from tulip_testbed.effects.effect import Effect
from tulip_testbed.sim.measurements.contacts import Contacts
from tulip_testbed.sim.robot import Robot


def acts_on(effect: Effect, contacts: Contacts | None) -> bool:
    """Return whether an effect acts on such contact sensors; None: plates on four cells each."""
    if effect.instrument == "cells":
        return contacts is None
    if effect.instrument == "wrenches":
        return contacts is not None
    return effect.instrument != "plates" or contacts is None or contacts.mount == "ground"


def targets_in(
    effect: Effect, robot: Robot, contacts: Contacts | None, placements: tuple[int, ...]
) -> tuple[str, ...]:
    """List the targets that an effect has in an experiment; none if it does not act on its sensors."""
    if not acts_on(effect, contacts):
        return ()
    targets = effect.targets.of(robot, placements)
    if effect.targets.word != "FOOT.CHANNEL" or contacts is None:
        return targets
    return tuple(target for target in targets if target.partition(".")[2] in contacts.channels)

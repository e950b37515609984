"""Which effects an experiment can have, by the contact sensors with which it was measured."""

from __future__ import annotations

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.effects.arranged import split_target, targets_over
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.effect import Effect
from tulip_testbed.measurements.contacts import Contacts
from tulip_testbed.measurements.manipulations import Experiment
from tulip_testbed.sim.robot import Robot


def acts_on(effect: Effect, contacts: Contacts | None) -> bool:
    """Return whether an effect acts on such contact sensors; None: plates on four cells each."""
    if effect.instrument == "cells":
        return contacts is None
    if effect.instrument == "wrenches":
        return contacts is not None
    return effect.instrument != "plates" or contacts is None or contacts.mount == "ground"


def effects_on(contacts: Contacts | None, statics: bool = False) -> list[Effect]:
    """List the effects that act on such contact sensors.

    Args:
        statics: leave out those that only the full dynamics can simulate.
    """
    return [e for e in catalogue().values() if acts_on(e, contacts) and (e.statics or not statics)]


def check_instrument(effect: Effect, contacts: Contacts | None, where: str) -> None:
    """Refuse an effect on sensors that a laboratory does not have.

    Raises:
        InputError: with the effects that act on its sensors.
    """
    if not acts_on(effect, contacts):
        sensors = "plates on cells" if contacts is None else f"wrench sensors ({contacts.mount})"
        raise InputError(
            f"{where}: found {effect.name} in a laboratory with {sensors}; expected one of "
            f"{listed(one.name for one in effects_on(contacts))}"
        )


def targets_in(
    effect: Effect,
    robot: Robot,
    contacts: Contacts | None,
    placements: tuple[int, ...],
    experiments: tuple[Experiment, ...] = (),
) -> tuple[str, ...]:
    """List the targets that an effect has in an experiment; none if it does not act on its sensors.

    Args:
        experiments: those that were joined; empty: one in an ordinary laboratory.
    """
    if not acts_on(effect, contacts):
        return ()
    targets = targets_over(effect, effect.targets.of(robot, placements), experiments)
    if effect.targets.word != "FOOT.CHANNEL" or contacts is None:
        return targets
    return tuple(
        target for target in targets if split_target(target)[0].partition(".")[2] in contacts.channels
    )

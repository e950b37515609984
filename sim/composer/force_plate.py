"""A force plate as an entity: a board on four load cells."""

from __future__ import annotations

import numpy as np
from dm_control import composer, mjcf
from dm_control.composer.observation import observable

from tulip_testbed.sim.composer.channel import Channel
from tulip_testbed.sim.composer.parts import Part


class ForcePlate(composer.Entity):
    """One of the two plates.

    Attributes:
        cells: the sensor elements of its four cells in the order of `CORNERS`.
        tare: what they read under the empty board, (4,) [N].
        interval: physics steps from sample to sample.
    """

    def _build(self, part: Part, cells: list[str], tare: np.ndarray, channel: Channel, interval: int) -> None:
        self._root = part.root
        self.cells = [part.root.find("sensor", name) for name in cells]
        self.tare, self.channel, self.interval = tare, channel, interval

    def _build_observables(self) -> PlateObservables:
        return PlateObservables(self)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        return self._root

    def initialize_episode(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        self.channel.draw(random_state)


class PlateObservables(composer.Observables):
    """What is read of a plate; the true forces are disabled."""

    @composer.observable
    def cells(self) -> observable.Generic:
        """Tared cell forces in the order of `CORNERS`, (4,) [N]."""
        cells = observable.Generic(
            self._true_forces, update_interval=self._entity.interval, corruptor=self._entity.channel
        )
        cells.enabled = True
        return cells

    @composer.observable
    def true_cells(self) -> observable.Generic:
        """The same without the sensors' errors, (4,) [N]."""
        return observable.Generic(self._true_forces)

    def _true_forces(self, physics: mjcf.Physics) -> np.ndarray:
        return np.asarray(physics.bind(self._entity.cells).sensordata) - self._entity.tare

"""The laboratory's sensors as corruptors of dm_control's observables."""

from __future__ import annotations

import numpy as np

from tulip_testbed.sim.sensors import corrupted


class Channel:
    """Sensors of one kind, by the figures of `sim.sensors.Sensors`.

    A class because its error of repeatability stays for an episode.

    Attributes:
        gain: true gain of every sensor, (n,).
        offset: this episode's error of repeatability, (n,).
    """

    def __init__(self, gain: np.ndarray, repeatability: float, noise: float, resolution: float):
        self.gain = gain
        self.repeatability, self.noise, self.resolution = repeatability, noise, resolution
        self.offset = np.zeros_like(gain)

    def draw(self, random_state: np.random.RandomState) -> None:
        """Draw what a whole episode has in common."""
        self.offset = self.repeatability * random_state.standard_normal(self.gain.shape)

    def __call__(self, truth: np.ndarray, random_state: np.random.RandomState) -> np.ndarray:
        """One reading, (n,)."""
        signal = self.gain * np.asarray(truth) + self.offset
        return corrupted(signal, self.noise, self.resolution, random_state)

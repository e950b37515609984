"""The commanded motion of a plan that moves."""

from dataclasses import dataclass

import numpy as np

RATE = 100.0  # Hz, of a commanded motion


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Commanded joint angles in segments: motions without interruption, each on one placement and support.

    Attributes:
        time: of motion, without what lies between two segments, (n,) [s]; it increases within a segment.
        segment, placement: numbers, (n,). support: "double", "right" or "left", (n,).
        joint_angles: (n, n_joints) [rad].
        torques: feed-forward torques of the drives, (n, n_joints) [N m]; None: no feed-forward.
    """

    time: np.ndarray
    segment: np.ndarray
    placement: np.ndarray
    support: np.ndarray
    joint_angles: np.ndarray
    torques: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.time)

    @property
    def segments(self) -> list[slice]:
        return runs(self.segment)

    @property
    def seconds(self) -> float:
        """Return the time of all segments together [s]."""
        return sum(float(self.time[rows][-1] - self.time[rows][0]) for rows in self.segments)

    @property
    def fastest(self) -> tuple[int, float]:
        """Return the fastest joint, by its column, and its speed [rad/s]."""
        speeds = [
            np.abs(np.diff(self.joint_angles[rows], axis=0) / np.diff(self.time[rows])[:, None]).max(axis=0)
            for rows in self.segments
        ]
        most = np.max(speeds, axis=0)
        return int(most.argmax()), float(most.max())


def runs(labels: np.ndarray) -> list[slice]:
    """Return the slices of equal labels that follow each other."""
    ends = np.flatnonzero(labels[1:] != labels[:-1]) + 1
    return [slice(int(a), int(b)) for a, b in zip([0, *ends], [*ends, len(labels)], strict=True) if b > a]

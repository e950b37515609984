"""The camera of the drawn postures."""

import numpy as np
import pytest

from tulip_testbed.rendering import ABOVE, EDGE, SIDE, least_distance

FOVY = 45.0  # deg


@pytest.mark.parametrize("ratio", [0.75, 1.6])
def test_every_point_is_in_the_picture_and_the_camera_no_farther_than_needed(ratio):
    """By angles seen from the camera, not by the formula of the distance."""
    rng = np.random.default_rng(3)
    points, target = rng.uniform([-0.4, -0.9, 0.0], [0.4, 0.9, 2.2], (40, 3)), np.array([0.0, 0.1, 0.6])
    distance = least_distance(points, target, FOVY, ratio)
    side, up = np.radians([SIDE, ABOVE])

    def largest(distance):
        """Of all points, the angle from the picture's middle over that of its edge."""
        # MuJoCo's azimuth turns about z and its elevation tilts upwards: the camera looks from behind there.
        turn = np.array([[np.cos(side), -np.sin(side), 0], [np.sin(side), np.cos(side), 0], [0, 0, 1]])
        tilt = np.array([[np.cos(up), 0, -np.sin(up)], [0, 1, 0], [np.sin(up), 0, np.cos(up)]])
        seen = (points - target) @ turn @ tilt + [distance, 0, 0]
        assert (seen[:, 0] > 0).all()
        wide = 2 * np.arctan(ratio * np.tan(np.radians(FOVY) / 2))
        across, above = np.arctan2(seen[:, 1], seen[:, 0]), np.arctan2(seen[:, 2], seen[:, 0])
        return max(np.abs(across).max() / (wide / 2), np.abs(above).max() / (np.radians(FOVY) / 2))

    assert largest(distance) < 1
    assert largest(distance / EDGE) == pytest.approx(1)

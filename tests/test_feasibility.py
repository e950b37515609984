"""Support polygon, clearance and boards."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tulip_testbed.identification.feasibility import (
    boards_fit,
    foot_clearance,
    place_polygon,
    predicted_cell_loads,
    predicted_foot_loads,
    stability_margin,
    support_polygon,
)
from tulip_testbed.measurements import lay_boards

SOLE = np.array([[0.13, 0.05], [0.13, -0.05], [-0.07, -0.05], [-0.07, 0.05]])


def test_margin_of_a_rectangle():
    polygon = support_polygon(SOLE)
    assert stability_margin(np.array([0.03, 0.0]), polygon) == pytest.approx(0.05)
    assert stability_margin(np.array([0.12, 0.0]), polygon) == pytest.approx(0.01)
    assert stability_margin(np.array([0.15, 0.0]), polygon) == pytest.approx(-0.02)


@pytest.mark.parametrize(
    ("pose", "clearance"),
    [([0, 0.2, 0], 0.1), ([0, 0.1, 0], 0.0), ([0, 0.05, 0], 0.0), ([0.5, 0.2, 0], np.hypot(0.3, 0.1))],
)
def test_clearance_between_feet(pose, clearance):
    assert foot_clearance(SOLE, place_polygon(SOLE, np.array(pose))) == pytest.approx(clearance, abs=1e-12)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    x=st.floats(-0.4, 0.4), y=st.floats(-0.4, 0.4), yaw=st.floats(-3, 3), turn=st.floats(-3, 3),
    shift=st.tuples(st.floats(-1, 1), st.floats(-1, 1)),
)  # fmt: skip
def test_clearance_does_not_depend_on_the_frame_and_is_symmetric(x, y, yaw, turn, shift):
    other = place_polygon(SOLE, np.array([x, y, yaw]))
    distance = foot_clearance(SOLE, other)
    frame = np.array([*shift, turn])
    assert foot_clearance(place_polygon(SOLE, frame), place_polygon(other, frame)) == pytest.approx(
        distance, abs=1e-9
    )
    assert foot_clearance(other, SOLE) == pytest.approx(distance, abs=1e-12)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(x=st.floats(-0.05, 0.1), y=st.floats(0.0, 0.2), step=st.floats(-0.12, 0.12))
def test_predicted_loads_carry_the_weight_at_the_com(plate, x, y, step):
    com, ankles = np.array([x, y]), np.array([[0.0, 0.0], [step, 0.2]])
    soles = np.array([SOLE, SOLE + ankles[1]])
    boards = lay_boards(soles, plate.size, 0.01)
    share, cop = predicted_foot_loads(com, ankles)
    cells = predicted_cell_loads(share, cop, boards, plate, 225.63).reshape(2, 4)
    own = plate.mass * 9.81
    assert cells.sum() == pytest.approx(225.63 + 2 * own)
    positions = plate.cells + boards[:, None, :2]
    moment = ((cells - own / 4)[..., None] * positions).sum(axis=(0, 1))
    if 0.02 < (com - ankles[0]) @ ankles[1] / (ankles[1] @ ankles[1]) < 0.98:
        assert moment / 225.63 == pytest.approx(com, abs=1e-12)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(x=st.floats(-0.12, 0.12), y=st.floats(0.12, 0.28), yaw=st.floats(-0.52, 0.52))
def test_boards_lie_parallel_apart_and_under_their_feet(plate, x, y, yaw):
    soles = np.array([SOLE, place_polygon(SOLE, np.array([x, y, yaw]))])
    boards = lay_boards(soles, plate.size, 0.01)
    assert (boards[:, 2] == 0).all()
    assert boards[1, 1] - boards[0, 1] >= plate.size[1] + 0.01 - 1e-12
    if boards_fit(soles, boards, plate):
        assert (np.abs(soles - boards[:, None, :2]) <= plate.size / 2 + 1e-9).all()

"""Eq. 11 by hand."""

import dataclasses

import numpy as np
import pytest

from tulip_testbed.base.errors import InputError
from tulip_testbed.identification.center_of_pressure import (
    cell_positions,
    center_of_pressure,
    load_shares,
    total_mass,
)


@pytest.fixture
def measured(wii):
    return wii.measurements


def test_all_weight_on_one_cell_is_at_that_cell(measured):
    forces = np.zeros((len(measured), 8))
    forces[:, 5] = 100.0  # left plate, front right
    poses = np.zeros((len(measured), 2, 3))
    poses[:, 1] = [0.3, 0.2, np.pi / 2]
    moved = dataclasses.replace(measured, cell_forces=forces, plate_poses=poses)
    # (0.2165, -0.119) turned by 90 degrees is (0.119, 0.2165)
    assert center_of_pressure(moved) == pytest.approx(np.tile([0.419, 0.4165], (len(measured), 1)))
    assert load_shares(moved)[0].tolist() == [0.0, 1.0]
    assert total_mass(moved) == pytest.approx((100 / 9.81, 0.0), abs=1e-12)


def test_equal_cells_give_the_mean_of_the_cells(measured):
    even = dataclasses.replace(measured, cell_forces=np.full((len(measured), 8), 25.0))
    assert center_of_pressure(even) == pytest.approx(cell_positions(even).mean(axis=1))


def test_no_weight_is_refused(measured):
    empty = dataclasses.replace(measured, cell_forces=np.zeros((len(measured), 8)))
    with pytest.raises(InputError, match=r"row 1: cells sum to 0\.00 N"):
        center_of_pressure(empty)

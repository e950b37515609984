"""The signatures of the docs: every effect has one, they are small, and their figures are right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from studies.teaching.signature import example, examples, lever, signature
from studies.teaching.variables import VARIABLES
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance

DOCS = Path(__file__).resolve().parents[1] / "docs" / "pictures"


def test_every_effect_has_a_picture_without_references():
    assert {path.stem for path in (DOCS / "signatures").iterdir()} == set(catalogue())
    for path in (DOCS / "signatures").glob("*.svg"):
        text = path.read_text()
        assert path.stat().st_size < 40_000, path.name
        links = [part.split('"')[0] for part in text.split('href="')[1:]]
        assert links
        assert all(link.startswith("#") for link in links), path.name


def test_columns_of_the_ankle_roll_pair_differ_by_its_cosine(nominal, plan):
    columns = nominal.parameters.regressor(plan.joint_angles)
    for side, (leg, foot) in (("right", (11, 12)), ("left", (14, 15))):
        roll = plan.joint_angles[:, plan.joints.index(f"{side}_ankle_roll")]
        assert columns[:, :, leg] == pytest.approx(np.cos(roll)[:, None] * columns[:, :, foot], abs=1e-6)


def test_an_offset_moves_the_error_by_its_lever(robot, two):
    found = signature(EffectInstance.parse("encoder-offset:right_knee=0.001", robot), robot, two)
    predicted = -np.degrees(0.001) * lever(found.observed, "right_knee")
    assert found.error == pytest.approx(predicted, abs=0.02)
    assert np.abs(found.error).max() > 0.2


def test_a_tilt_moves_the_error_by_the_height(robot, two):
    found = signature(EffectInstance.parse("tilt=0.01,0.02", robot), robot, two)
    expected = 1e3 * found.observed.height[:, None] * [0.02, -0.01]
    assert found.error == pytest.approx(expected, abs=0.03)


def test_there_is_an_example_of_every_effect(robot):
    found = examples(robot)
    assert [one.effect.name for one in found] == list(catalogue())
    assert set(VARIABLES) <= set(catalogue())
    for one in found:
        assert EffectInstance.parse(str(one), robot, (1, 2, 3)).label == one.label
    assert example(catalogue()["cell-tare"], robot).values == (1.645,)


def test_an_effect_of_the_dynamics_is_predicted(robot, two):
    assert not signature(example(catalogue()["unsettled"], robot), robot, two).simulated

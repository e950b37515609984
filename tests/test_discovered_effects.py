"""Effects at several times their minimum detectable size, found by name and size."""

from __future__ import annotations

import dataclasses

import pytest

from tests.effect_changes import measured
from tulip_testbed.discovery.discover import discover
from tulip_testbed.effects.instance import EffectInstance

SEED = 7501  # no development seed


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    [
        "creep:left.front_right=0.02,0.1",
        pytest.param("plate-drift:right=-0.5", marks=pytest.mark.slow),
        "encoder-load:left_ankle_pitch=5e-6",
        pytest.param("lag:right_hip_pitch=0.002", marks=pytest.mark.slow),
        pytest.param("logged-command:left_knee=command", marks=pytest.mark.slow),
        pytest.param("rocking:right.front_left=0.0003", marks=pytest.mark.slow),
    ],
)
def test_an_effect_is_named_with_its_size(text, robot, plan):
    hidden = EffectInstance.parse(text, robot, plan.placement.tolist())
    data = measured(robot, plan, "force-plate", (hidden.effect.name, hidden.target, hidden.values), seed=SEED)
    found = discover(data, robot, hold_out=False)
    assert found.verdict == "named"
    (adopted,) = found.adopted
    assert adopted.label == hidden.label
    for value, interval in zip(hidden.values, adopted.intervals, strict=True):
        if interval is not None:  # five sizes: 1.5 half widths are 99.7 %
            assert abs(value - sum(interval) / 2) < 1.5 * (interval[1] - interval[0]) / 2


@pytest.mark.slow
@pytest.mark.xfail(
    strict=True, reason="named: compliance and lag of that joint, see docs/studies/ordinary-laboratories.md"
)
def test_without_motors_a_logged_command_is_not_named_something_else(robot, plan):
    """Dry friction bears a part of the load, which neither servo nor compliance explains."""
    hidden = ("logged-command", "right_knee", (1.0,))
    data = dataclasses.replace(measured(robot, plan, "force-plate", hidden, seed=SEED), motor=None)
    found = discover(data, robot)
    assert found.verdict == "unknown" or [one.label for one in found.adopted] == ["logged-command:right_knee"]

"""The rig folder: what was found becomes the laboratory, and nothing broken does."""

import json

import numpy as np
import pytest

from tests.edited_files import write_rig
from tests.effect_changes import statically
from tests.test_cli import told
from tests.test_refusals import refuse
from tulip_testbed.effects.instance import EffectInstance, injected
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.rig_folder import CHANGED, DIFF, NOMINAL, read_rig
from tulip_testbed.identification.estimators import MIXED_MODEL
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import load_spec

SEED = 231
TEXTS = ("encoder-offset:right_knee=0.01", "joint-compliance:left_ankle_roll=0.0005")


@pytest.fixture(scope="module")
def found(robot):
    return tuple(EffectInstance.parse(text, robot, range(30)) for text in TEXTS)


@pytest.fixture
def rig(found, robot, tmp_path):
    write_rig(tmp_path / "rig", robot, found)
    return tmp_path / "rig"


def measured_here(robot, plan, found):
    return statically(injected(preset_rig("force-plate", robot), found), plan, SEED)


def test_what_is_written_is_read(rig, found, robot):
    assert read_rig(rig, robot) == found


def test_the_scenes_are_mjcf_and_the_difference_is_what_changed(rig):
    nominal, changed = (load_spec(rig / name) for name in (NOMINAL, CHANGED))
    assert nominal.joint("left_ankle_roll_yield") is None
    assert changed.joint("left_ankle_roll_yield").stiffness[0] == pytest.approx(2000)
    text = (rig / DIFF).read_text()
    assert '+                  <joint name="left_ankle_roll_yield"' in text
    assert "Readings are changed" in text
    assert "right_knee: offset 0.01 rad" in text
    assert len(text.splitlines()) < 25


def test_an_adopted_effect_of_the_physics_takes_its_bias_away(robot, plan):
    plain = identify(measured_here(robot, plan, ()), robot, estimator=MIXED_MODEL).full
    texts = ("joint-compliance:right_ankle_pitch=0.0005", "cell-gain:right.rear_left=0.03")
    effects = tuple(EffectInstance.parse(text, robot, range(30)) for text in texts)
    hidden = measured_here(robot, plan, effects)
    truth = np.sqrt(np.diag(plain.covariance))
    biased = np.abs((identify(hidden, robot, estimator=MIXED_MODEL).full.value - plain.value) / truth)
    mended = np.abs(
        (identify(hidden, robot, estimator=MIXED_MODEL, adopted=effects).full.value - plain.value) / truth
    )
    # A few postures are lost to the effect, so the estimates differ by chance.
    assert np.sqrt((biased**2).mean()) > 3
    assert np.sqrt((mended**2).mean()) < 1.5


def test_a_rig_of_a_placement_that_is_not_there(robot, plan, tmp_path):
    blunder = EffectInstance.parse("placement-blunder:7=0.01,0.0", robot, [7])
    write_rig(tmp_path / "rig", robot, [blunder])
    assert read_rig(tmp_path / "rig", robot) == (blunder,)
    few = plan.take(plan.placement <= 2)
    refuse("unknown target '7'; valid: 1, 2", Laboratory(robot).with_known(blunder).run, few)
    measured = statically(preset_rig("wii", robot), few)
    refuse("unknown target '7'; valid: 1, 2", identify, measured, robot, adopted=[blunder])


def test_a_monte_carlo_in_the_adopted_laboratory_is_freed_of_it(rig, robot, tmp_path, capsys):
    numbers = []
    for more in ((), ("--corrections", str(rig))):
        out = tmp_path / f"run{len(more)}"
        run = ["montecarlo", "--sensors", "force-plate", "--runs", "4", "--workers", "1", "--seed", "232"]
        run += ["--estimator", MIXED_MODEL, "--imperfections", "0"]
        report = told(capsys, *run, "--out", out, *more, code=3)
        assert report["verdict"] == "inconclusive"
        numbers.append([row["bias"] / row["standard_error"] for row in report["parameters"]])
    assert np.abs(numbers).max() < 2
    run_file = json.loads((tmp_path / "run2" / "run.json").read_text())
    assert [found["name"] for found in run_file["configuration"]["adopted"]] == [
        "encoder-offset",
        "joint-compliance",
    ]

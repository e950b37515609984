"""Six standing windows of a real iCub: import, check and predict, on data that are not in the repository."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

import tulip_testbed as tt
from tulip_testbed.cli.main import main

FOLDER = os.environ.get("TULIP_ICUB_STAND")
SOURCE = (
    "set TULIP_ICUB_STAND to a folder with iCubGenova04.urdf and standing_windows.csv, made from the public "
    "repository ami-iit/kindyn-vio, commit b5a04bfa31efa5b94a3be2860c93794ee99533a3, src/TestData"
)
MAP = Path(__file__).parent.parent / "examples" / "icub_stand.toml"
FEET = ("r_ankle_2", "l_ankle_2")
SOLE = ("0.14", "0.06", "0.09", "0.0645")

pytestmark = pytest.mark.skipif(FOLDER is None, reason=SOURCE)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """The robot and the measurement folder, made by the commands that the example names."""
    assert FOLDER is not None
    folder = tmp_path_factory.mktemp("icub")
    urdf, table = Path(FOLDER) / "iCubGenova04.urdf", Path(FOLDER) / "standing_windows.csv"
    assert main(["robot", str(urdf), "--feet", *FEET, "--sole", *SOLE, "--out", str(folder / "robot")]) == 0
    robot = str(folder / "robot" / "robot.toml")
    arguments = ["--robot", robot, "--map", str(MAP), "--out", str(folder / "stand")]
    assert main(["import", str(table), *arguments]) == 0
    return folder


@pytest.fixture(scope="module")
def icub(place):
    return tt.load_robot(place / "robot" / "robot.toml")


def document(capsys, *arguments):
    capsys.readouterr()
    code = main([*map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_the_import_maps_every_logged_joint_and_confirms_signs_by_the_legs(place, capsys, tmp_path):
    assert FOLDER is not None
    _, told = document(
        capsys,
        *("import", Path(FOLDER) / "standing_windows.csv", "--robot", place / "robot" / "robot.toml"),
        *("--map", MAP, "--out", tmp_path / "stand"),
    )
    joints = [name for name in told["mapped"] if name.startswith("q.")]
    assert len(joints) == 26
    assert told["mapped"]["q.r_hip_pitch"]["checked"] == "closed legs"
    assert told["mapped"]["wrench.left.fz"] == {
        "column": "l_sole.fz [N]",
        "unit": "N",
        "sign": 1,
        "by": "words of the name",
        "checked": "weight",
    }
    assert told["problems"] == []


def test_weight_and_centre_of_pressure_agree_with_the_cad_model(place, icub):
    """By MuJoCo's centre of mass and the wrenches alone, each foot's place from MuJoCo's kinematics."""
    import mujoco

    m = tt.read_measurements(place / "stand")
    assert m.wrenches is not None
    model, data = icub.model, mujoco.MjData(icub.model)
    mass = float(model.body_mass.sum())
    weight = m.wrenches[:, :, 2].sum(axis=1)
    assert weight / 9.81 / mass == pytest.approx(np.ones(6), abs=0.04)
    for row in range(6):
        for joint, angle in zip(m.joints, m.joint_angles[row], strict=True):
            data.joint(joint).qpos = angle
        mujoco.mj_forward(model, data)
        base = data.body(FEET[0])
        turn = base.xmat.reshape(3, 3)
        moment = np.zeros(2)
        for foot, (_, _, fz, mx, my, _) in zip(FEET, m.wrenches[row], strict=True):
            body = data.body(foot)
            point = body.xpos + body.xmat.reshape(3, 3) @ [-my / fz, mx / fz, -0.0645]
            moment += fz * (turn.T @ (point - base.xpos))[:2]
        center = (turn.T @ (data.subtree_com[1] - base.xpos))[:2]
        assert np.abs(center - moment / weight[row]).max() < 0.006


def test_check_says_that_the_horizontal_forces_do_not_cancel(place, capsys):
    _, told = document(capsys, "check", place / "stand", "--robot", place / "robot" / "robot.toml")
    checks = {check["name"]: check for check in told["checks"]}
    assert checks["horizontal forces"]["result"] in ("warn", "fail")
    assert "they do not cancel" in checks["horizontal forces"]["seen"]
    assert checks["carried weight"]["result"] == "pass"
    assert checks["legs close"]["result"] == "pass"
    assert checks["cell loads"]["result"] == "not evaluated"
    assert "there are wrench sensors" in checks["cell loads"]["seen"]


def test_six_windows_do_not_decide_whether_the_identified_model_beats_cad(place, capsys):
    code, told = document(capsys, "predict", place / "stand", "--robot", place / "robot" / "robot.toml")
    assert code == 0
    assert told["beats_cad"] is None
    by = {(one["name"], one["split"]): one["rms_mm"] for one in told["models"]}
    assert max(by["CAD", "halves"].values()) < 6
    assert max(by["identified", "halves"].values()) < 6
    assert by["constant", "halves"]["x"] > 20

"""Effects on the command line: explained, simulated, drawn; only the truth file names them."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from tests.edited_files import write_rig
from tests.test_cli import refused, told
from tulip_testbed.base.errors import InputError
from tulip_testbed.cli.main import main
from tulip_testbed.effects.catalogue import catalogue, effects_on
from tulip_testbed.effects.instance import EffectInstance, check_instance
from tulip_testbed.effects.random_effects import draw_effect
from tulip_testbed.measurements import read_measurements

OFFSET = "encoder-offset:right_knee=0.01"


def simulated(folder, *more):
    assert (
        main(["simulate", "--engine", "statics", "--seed", "241", "--out", str(folder), *map(str, more)]) == 0
    )
    return read_measurements(folder)


def test_all_effects_are_listed(capsys):
    assert main(["atlas", "effects"]) == 0
    out = capsys.readouterr().out
    assert "encoder-offset:JOINT=OFFSET" in out
    assert all(name in out for name in catalogue())
    listed = told(capsys, "atlas", "effects")["effects"]
    assert [effect["name"] for effect in listed] == list(catalogue())
    assert "tilt=ABOUT_X,ABOUT_Y" in repr(catalogue())
    assert catalogue()._repr_html_().count("<tr>") == len(catalogue()) + 1
    assert repr(catalogue()["tilt"]) == "<Effect tilt=ABOUT_X,ABOUT_Y>"
    assert pickle.loads(pickle.dumps(catalogue())) is catalogue()


def test_one_effect_is_explained(capsys):
    assert main(["atlas", "effects", "encoder-offset"]) == 0
    out = capsys.readouterr().out
    assert "Usage: encoder-offset:JOINT=OFFSET" in out
    assert "OFFSET [rad]: s.d. 1 deg" in out
    assert "has a wrong zero" in out
    assert "left_knee" in out
    assert "unknown effect 'encoder-ofset'; did you mean 'encoder-offset'" in refused(
        capsys, "atlas", "effects", "encoder-ofset"
    )


def test_a_hidden_effect_leaves_the_noise_and_the_folder_as_they_are(tmp_path):
    plain = simulated(tmp_path / "plain")
    hidden = simulated(tmp_path / "data", "--effects", OFFSET, "--truth", tmp_path / "truth.json")
    column = plain.joints.index("right_knee")
    change = hidden.joint_angles - plain.joint_angles
    assert change[:, column] == pytest.approx(np.full(len(plain), 0.01), abs=1e-12)
    assert np.delete(change, column, axis=1) == pytest.approx(0.0)
    assert np.array_equal(hidden.cell_forces, plain.cell_forces)
    manifests = [json.loads((tmp_path / name / "manifest.json").read_text()) for name in ("plain", "data")]
    assert manifests[0].keys() == manifests[1].keys()
    assert all(
        manifests[0][key] == manifests[1][key] for key in manifests[0] if key not in ("created", "tables")
    )
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["effects"] == [
        {
            "name": "encoder-offset",
            "target": "right_knee",
            "parameters": [{"name": "offset", "value": 0.01, "unit": "rad", "low95": None, "high95": None}],
        }
    ]
    assert truth["configuration"]["statics"] is True


def everything_in(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file())


@pytest.mark.parametrize("style", [(), ("--json",)])
def test_a_random_effect_tells_the_truth_file_alone(style, tmp_path, capsys):
    simulated(tmp_path / "data", "--effects", "random", "--truth", tmp_path / "truth.json", *style)
    (effect,) = json.loads((tmp_path / "truth.json").read_text())["effects"]
    assert effect["name"] in catalogue()
    assert all(parameter["value"] != 0 for parameter in effect["parameters"])
    printed = "".join(capsys.readouterr()).replace("\n", "").replace(str(tmp_path), "")
    # Joints and cells are column names; a reason for a lost posture could be a hint.
    words = [effect["name"], "effect", "random", "dropped 1", "lost sole"]
    folder = everything_in(tmp_path / "data").decode("latin-1")
    values = [repr(parameter["value"])[:8] for parameter in effect["parameters"]]
    assert not [word for word in words if word in printed]
    assert not [word for word in [effect["name"], "effect", "random", *values] if word in folder]
    assert '"reason": "' not in printed


def test_a_random_effect_that_cannot_be_simulated_is_not_named(tmp_path, capsys, monkeypatch):
    def fail(*_):
        raise InputError("joint-compliance at left_knee is too soft")

    monkeypatch.setattr("tulip_testbed.experiments.laboratory.run_statics", fail)
    more = ("--engine", "statics", "--effects", "random", "--truth", tmp_path / "truth.json")
    message = refused(capsys, "simulate", "--out", tmp_path / "data", *more)
    assert "give another seed" in message
    assert "knee" not in message
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("statics", [True, False])
def test_draws_are_valid_and_of_all_kinds(statics, robot):
    rng, placements = np.random.default_rng(242), range(1, 31)
    drawn = [draw_effect(robot, placements, rng, statics) for _ in range(600)]
    for found in drawn:
        check_instance(found, robot, placements, "draw")
        assert found.finding
    possible = [effect.name for effect in effects_on(None, statics) if effect.searched]
    assert {found.effect.name for found in drawn} == set(possible)
    sizes = [f.values[0] for f in drawn if f.effect.name == "encoder-offset"]
    assert np.std(sizes) == pytest.approx(np.radians(1.0), rel=0.5)


def test_a_rig_is_the_new_nominal_laboratory(tmp_path, robot, capsys):
    write_rig(tmp_path / "rig", robot, [EffectInstance.parse(OFFSET, robot, [1])])
    hidden = simulated(tmp_path / "hidden", "--effects", OFFSET)
    adopted = simulated(
        tmp_path / "adopted", "--corrections", tmp_path / "rig", "--truth", tmp_path / "t.json"
    )
    assert np.array_equal(hidden.joint_angles, adopted.joint_angles)
    truth = json.loads((tmp_path / "t.json").read_text())
    assert truth["effects"] == []
    assert [found["name"] for found in truth["configuration"]["adopted"]] == ["encoder-offset"]
    plain = simulated(tmp_path / "plain")
    assert len(plain) == len(hidden)
    capsys.readouterr()
    documents = []
    for arguments in (["plain"], ["hidden", "--corrections", str(tmp_path / "rig")]):
        quick = ["--estimator", "mixed-model", "--json"]
        assert main(["identify", str(tmp_path / arguments[0]), *arguments[1:], *quick]) == 0
        documents.append(json.loads(capsys.readouterr().out))
    estimates = [document["full"]["value"] for document in documents]
    assert estimates[1] == pytest.approx(estimates[0], abs=1e-9)
    (correction,) = documents[1]["corrections"]
    assert (correction["name"], correction["target"]) == ("encoder-offset", "right_knee")
    assert main(["identify", str(tmp_path / "hidden"), "--corrections", str(tmp_path / "rig")]) == 0
    assert "Corrected: The right knee encoder reads 0.573 deg too high." in capsys.readouterr().out

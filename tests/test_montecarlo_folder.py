"""The folder of a Monte Carlo: resumed by the same settings alone."""

import dataclasses
import json

import pytest

import tulip_testbed as tt
from tulip_testbed.base.errors import InputError
from tulip_testbed.base.machine import machine
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo, Settings, montecarlo_file
from tulip_testbed.experiments.montecarlo.montecarlo_run import raise_runs, run_folder

SETTINGS = Settings(runs=100, seed=5, estimator="mixed-model", robot_spread=None, imperfections=0)


@pytest.fixture
def scenario(robot, plan):
    return Laboratory(robot, "wii"), plan


def document_of(scenario, settings=SETTINGS):
    return montecarlo_file(scenario[0], scenario[1], settings)


def kept(folder, scenario, settings=SETTINGS):
    return run_folder(folder, document_of(scenario, settings))


def begin(folder, scenario, settings=SETTINGS):
    with kept(folder, scenario, settings).opened():
        pass


def test_other_settings_are_refused(scenario, tmp_path):
    begin(tmp_path / "run", scenario)
    with pytest.raises(InputError, match=r"settings\.robot_spread is None there and 0\.1 here"):
        begin(tmp_path / "run", scenario, dataclasses.replace(SETTINGS, robot_spread=0.1, engine="dynamics"))


def test_another_plan_or_preset_or_version_is_refused(scenario, robot, plan, tmp_path):
    folder = tmp_path / "run"
    begin(folder, scenario)
    with pytest.raises(InputError, match="preset is 'wii' there and 'ideal' here"):
        begin(folder, (Laboratory(robot, "ideal"), plan))
    moved = dataclasses.replace(plan, joint_angles=plan.joint_angles + 1e-9)
    with pytest.raises(InputError, match=r"inputs\.plan is"):
        begin(folder, (scenario[0], moved))
    with pytest.raises(InputError, match=r"configuration\.plan\.postures is 150 there and 5 here"):
        begin(folder, (scenario[0], plan.take(plan.placement == 1)))
    document = json.loads((folder / "run.json").read_text())
    document["software"]["numpy"] = "1.0"
    (folder / "run.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"software\.numpy is '1\.0' there"):
        begin(folder, scenario)


def test_a_plan_with_other_torques_is_another_plan(scenario, plan, tmp_path):
    laboratory, pushed = scenario[0], dataclasses.replace(plan, torques=plan.joint_angles)
    begin(tmp_path / "run", (laboratory, pushed))
    begin(tmp_path / "run", (laboratory, pushed))
    for other in (plan, dataclasses.replace(plan, torques=plan.joint_angles + 1e-3)):
        with pytest.raises(InputError, match=r"inputs\.plan is"):
            begin(tmp_path / "run", (laboratory, other))


def test_the_processor_is_recorded_and_another_one_may_go_on(scenario, tmp_path):
    folder = tmp_path / "run"
    begin(folder, scenario)
    document = json.loads((folder / "run.json").read_text())
    assert document["machine"] == machine()
    assert all(len(text) > 3 for text in document["machine"].values())
    for other in ({"cpu": "abacus"}, None):
        document["machine"] = other
        (folder / "run.json").write_text(
            json.dumps({name: value for name, value in document.items() if value is not None})
        )
        begin(folder, scenario)


def test_what_is_no_monte_carlo_is_refused(scenario, tmp_path):
    (tmp_path / "run").mkdir()
    with pytest.raises(InputError, match=r"holds no Monte Carlo \(run\.json\)"):
        begin(tmp_path / "run", scenario)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="holds no Monte Carlo"):
        begin(tmp_path / "file", scenario)
    (tmp_path / "run" / "run.json").write_text('{"format": "tulip-run"}')
    with pytest.raises(InputError, match="format is 'tulip-run' there"):
        begin(tmp_path / "run", scenario)


def test_more_runs_in_the_same_folder(robot, plan, tmp_path):
    """The last file, which was not full, is made anew; the folder ends as if made at once."""
    laboratory, few = Laboratory(robot, "wii"), plan.take(plan.placement <= 8)

    def carried_out(name, runs):
        return tt.monte_carlo(laboratory, few, runs=runs, out=tmp_path / name, workers=1)

    carried_out("raised", 1)
    found, straight = carried_out("raised", 2), carried_out("straight", 2)
    assert found.runs == 2
    assert found.errors_mm["full"].tolist() == straight.errors_mm["full"].tolist()
    straight.save(tmp_path / "saved")
    for file in ("run.json", "report.json", "runs/chunk-000000.parquet", "plan/plan.json"):
        expected = (tmp_path / "straight" / file).read_bytes()
        assert (tmp_path / "raised" / file).read_bytes() == expected
        assert (tmp_path / "saved" / file).read_bytes() == expected
    assert MonteCarlo.load(tmp_path / "saved", robot).to_json() == straight.to_json()
    assert MonteCarlo.from_json(straight.to_json()).tables() == straight.tables()
    assert carried_out("saved", 3).runs == 3


def test_more_runs_of_another_kind_are_refused(scenario, tmp_path):
    begin(tmp_path / "run", scenario)
    before = (tmp_path / "run" / "run.json").read_bytes()
    raise_runs(tmp_path / "run", document_of(scenario, dataclasses.replace(SETTINGS, runs=200, seed=6)))
    assert (tmp_path / "run" / "run.json").read_bytes() == before
    with (
        kept(tmp_path / "run", scenario).opened(),
        pytest.raises(InputError, match="another process is at work"),
    ):
        raise_runs(tmp_path / "run", document_of(scenario, dataclasses.replace(SETTINGS, runs=200)))
    assert (tmp_path / "run" / "run.json").read_bytes() == before
    raise_runs(tmp_path / "run", document_of(scenario, dataclasses.replace(SETTINGS, runs=200)))
    assert json.loads((tmp_path / "run" / "run.json").read_text())["settings"]["runs"] == 200

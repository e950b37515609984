"""What an independent attack on the library found."""

import copy
import dataclasses
import pickle
import shutil
from threading import Event, Thread

import numpy as np
import pytest
from threadpoolctl import threadpool_info

import tulip_testbed as tt
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.sim.shipped import TULIP


@pytest.fixture
def own(tmp_path):
    """A copy of TULip that may be edited."""
    return shutil.copytree(TULIP.parent, tmp_path / "own") / "tulip.toml"


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_robot_is_what_its_files_held_when_it_was_loaded(own):
    robot = tt.load_robot(own)
    edit(own.with_name("tulip.xml"), 'mass="10.7"', 'mass="20.7"')
    assert robot.model_hash == tt.load_robot().model_hash
    assert copy.deepcopy(robot) is robot
    with pytest.raises(tt.InputError, match=r"tulip\.xml was changed while the robot was in use"):
        tt.Laboratory(robot).run(tt.plans.random, engine="statics")
    with pytest.raises(tt.InputError, match="a file of the robot was changed"):
        pickle.loads(pickle.dumps(robot))


def test_a_plate_that_a_scene_includes_is_part_of_the_robot(own, two):
    robot = tt.load_robot(own)
    assert "plate.xml" in robot.hashes
    edit(own.with_name("plate.xml"), "0.2165", "0.1")
    with pytest.raises(tt.InputError, match=r"plate\.xml was changed while the robot was in use"):
        tt.Laboratory(robot).run(two)


def test_an_included_file_and_another_working_directory(own, tmp_path, monkeypatch):
    own.with_name("tulip.xml").rename(own.with_name("inner.xml"))
    own.with_name("tulip.xml").write_text('<mujoco><include file="inner.xml"/></mujoco>')
    monkeypatch.chdir(own.parent)
    robot = tt.load_robot("tulip.toml")
    monkeypatch.chdir(tmp_path)
    assert pickle.loads(pickle.dumps(robot)).model_hash == robot.model_hash
    edit(own.with_name("inner.xml"), 'mass="10.7"', 'mass="20.7"')
    assert tt.load_robot(own).model_hash != robot.model_hash


def test_a_plan_in_memory_must_fit_the_robot(own, robot):
    plan = tt.plans.random
    edit(own.with_name("tulip.xml"), 'mass="10.7"', 'mass="12.7"')
    other = tt.load_robot(own)
    angles = plan.joint_angles.copy()
    angles[3, 2] = np.nan
    for wrong, at, message in (
        (plan, other, "made for another robot"),
        (dataclasses.replace(plan, joints=plan.joints[::-1]), robot, "plan: found joints"),
        (dataclasses.replace(plan, joint_angles=angles), robot, "plan: row 4: found joint_angles"),
        (plan.take(np.zeros(len(plan), bool)), robot, "plan: found .* joint angles"),
        (dataclasses.replace(plan, joint_angles=np.degrees(plan.joint_angles)), robot, "expected within"),
    ):
        with pytest.raises(tt.InputError, match=message):
            tt.Laboratory(at).run(wrong, engine="statics")
        with pytest.raises(tt.InputError, match=message):
            tt.atlas(wrong, at)


def test_results_are_pickled_and_compared(robot, two):
    run = tt.Laboratory(robot).with_effects("cell-gain:right.front_left=0.03").run(two, engine="statics")
    again = pickle.loads(pickle.dumps(run))
    assert str(again.laboratory.hidden[0]) == str(run.laboratory.hidden[0])
    assert np.array_equal(again.measurements.cell_forces, run.measurements.cell_forces)
    assert run == run
    assert run != again
    assert len({run, again}) == 2


def test_the_shipped_plan_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        tt.plans.random.joint_angles[0, 0] += 0.05


def test_linear_algebra_has_one_thread_until_the_last_call_has_ended():
    def threads():
        return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]

    inside, leave = [Event(), Event()], [Event(), Event()]

    @one_blas_thread
    def work(k):
        inside[k].set()
        leave[k].wait(10)

    before, calls = threads(), [Thread(target=work, args=(k,)) for k in (0, 1)]
    for call, event in zip(calls, inside, strict=True):
        call.start()
        event.wait(10)
    leave[0].set()
    calls[0].join()
    assert set(threads()) == {1}
    leave[1].set()
    calls[1].join()
    assert threads() == before


def test_another_robots_run_has_a_page(own, tmp_path):
    edit(own.with_name("tulip.xml"), 'mass="10.7"', 'mass="10.9"')
    robot = tt.load_robot(own)
    plan = dataclasses.replace(tt.plans.random, robot={"model": "tulip.xml", "sha256": robot.model_hash})
    tt.monte_carlo(tt.Laboratory(robot), plan, runs=2, out=tmp_path / "mc", workers=1)
    with pytest.raises(tt.InputError, match="give the robot that the run was made with"):
        tt.report(tmp_path / "mc", tmp_path / "mc.html")
    tt.report(tmp_path / "mc", tmp_path / "mc.html", robot=robot)
    assert (tmp_path / "mc.html").exists()


def test_a_message_lists_forty_names_at_most():
    from tulip_testbed.base.errors import listed

    assert listed("abc") == "a, b, c"
    assert listed(range(1000)).endswith("38, 39 and 960 more")

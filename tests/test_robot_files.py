"""The files of a robot: changed while it is in use, in several folders, or fatal to a compiler."""

import copy
import pickle
import shutil

import pytest

import tulip_testbed as tt
from tests.edited_files import change_texts
from tulip_testbed.sim import sandbox
from tulip_testbed.sim.robot import load_spec


@pytest.fixture
def own(edited_tulip):
    """The description of a copy of TULip that may be edited."""
    return edited_tulip(built=False).path


def edit(path, old, new):
    change_texts(path.parent, [f"{path.name}: {old} => {new}"])


def test_a_robot_is_what_its_files_held_when_it_was_loaded(own):
    robot = tt.load_robot(own)
    edit(own.with_name("tulip.xml"), 'mass="10.7"', 'mass="20.7"')
    assert robot.model_hash == tt.load_robot().model_hash
    assert copy.deepcopy(robot) is robot
    with pytest.raises(tt.InputError, match=r"tulip\.xml was changed while the robot was in use"):
        tt.Laboratory(robot).run(tt.plans.random, engine="statics")
    with pytest.raises(tt.InputError, match="a file of the robot was changed"):
        pickle.loads(pickle.dumps(robot))


def test_an_included_file_and_another_working_directory(own, tmp_path, monkeypatch):
    own.with_name("tulip.xml").rename(own.with_name("inner.xml"))
    own.with_name("tulip.xml").write_text('<mujoco><include file="inner.xml"/></mujoco>')
    monkeypatch.chdir(own.parent)
    robot = tt.load_robot("tulip.toml")
    monkeypatch.chdir(tmp_path)
    assert pickle.loads(pickle.dumps(robot)).model_hash == robot.model_hash
    edit(own.with_name("inner.xml"), 'mass="10.7"', 'mass="20.7"')
    assert tt.load_robot(own).model_hash != robot.model_hash


def test_an_mjcf_may_lie_beside_the_folder_of_its_meshes_but_not_outside_the_robot_s(own):
    """robot/mjcf/robot.xml with meshdir ../meshes is how many robots come."""
    folder = own.parent
    (folder / "mjcf").mkdir()
    (folder / "meshes").mkdir()
    tetrahedron = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (folder / "meshes" / "a.obj").write_text(tetrahedron)
    shutil.move(folder / "tulip.xml", folder / "mjcf" / "tulip.xml")
    path = folder / "mjcf" / "tulip.xml"
    edit(path, "<compiler ", '<compiler meshdir="../meshes" ')
    edit(path, "<asset>", '<asset><mesh name="a" file="a.obj"/>')
    edit(folder / "tulip.toml", '"tulip.xml"', '"mjcf/tulip.xml"')
    assert tt.load_robot(own).visual_model.nmesh == 1
    with pytest.raises(
        tt.InputError, match=r"attribute 'meshdir': found '../meshes', expected a path inside"
    ):
        load_spec(path)
    edit(path, "../meshes", "../../meshes")
    with pytest.raises(tt.InputError, match=r"line \d+, <compiler>, attribute 'meshdir'"):
        tt.load_robot(own)


def test_a_crash_and_an_endless_compilation_are_survived(own, monkeypatch):
    path = own.with_name("tulip.xml")
    monkeypatch.setattr(sandbox, "CHILD", "import os; os.abort()")
    with pytest.raises(
        tt.InputError, match=r"tulip.xml: broken MJCF: MuJoCo crashed while compiling it \(SIGABRT\)"
    ):
        sandbox.try_to_compile(path, {path: {path: "crash"}})
    monkeypatch.setattr(sandbox, "CHILD", sandbox.CHILD.replace("os.abort()", "os.kill(os.getpid(), 24)"))
    with pytest.raises(tt.InputError, match="MuJoCo did not compile it within 20 s of processor time"):
        sandbox.try_to_compile(path, {path: {path: "endless"}})

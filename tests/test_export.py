"""`tulip export`: the file loads, holds the stated base parameters, and is otherwise the user's own."""

import dataclasses
import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import tulip_testbed as tt
from tests.edited_files import change_texts
from tests.posed import posed
from tests.published_robot import write_published
from tests.test_refusals import refuse
from tulip_testbed.experiments.export.export_model import export_model
from tulip_testbed.experiments.export.model_text import with_inertias
from tulip_testbed.experiments.export.published_links import PublishedLinks
from tulip_testbed.experiments.robot_import.robot_import import import_robot
from tulip_testbed.identification.base_parameters import base_parameters, standard_parameters
from tulip_testbed.identification.cad_prior import cad_prior
from tulip_testbed.identification.center_of_pressure import contact_pressure
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.pseudo_inertia import pseudo_inertia
from tulip_testbed.sim.random_robots import draw_robot
from tulip_testbed.sim.robot import joint_names

SEED = 4218  # development seeds are 0 to 99


@pytest.fixture(scope="module")
def run(robot):
    return tt.Laboratory(robot, "force-plate").run(tt.plans.random, SEED, "statics")


@pytest.fixture(scope="module")
def found(run, robot):
    return tt.identify(run.measurements, robot, estimator="mixed-model")


@pytest.fixture(scope="module")
def exported(found, robot, tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "identified.xml"
    return tt.export_model(found, robot, out=path)


def imagined(found, robot, standard, error=1e-4):
    """An identification that found these standard parameters."""
    parameters = base_parameters(robot)
    angles = np.zeros((len(found.measurements), len(parameters.tree.joints)))
    rows: Any = SimpleNamespace(joint_angles=angles, support=found.measurements.support)
    full = dataclasses.replace(
        found.full,
        numbers=np.arange(1, len(parameters.names) + 1),
        names=parameters.names,
        value=parameters.values(standard),
        covariance=error**2 * np.eye(len(parameters.names)),
    )
    mass = float(standard[:, 0].sum()), 0.01
    return dataclasses.replace(found, measurements=rows, parameters=parameters, full=full, mass=mass)


def center_of_mass(model, angles):
    """Centre of mass from the first hinge in the axes of the link above it, by MuJoCo's own kinematics."""
    data = posed(model, list(angles.values()), list(angles))
    mass, place = model.body_mass, data.xipos
    whole = mass @ place / mass.sum()
    joint = model.joint(next(iter(angles))).id
    above = int(model.body_parentid[model.jnt_bodyid[joint]])
    return data.xmat[above].reshape(3, 3).T @ (whole - data.xanchor[joint])


INERTIAL = re.compile(rb"<inertial\b[^>]*/>|<inertial\b[^>]*>.*?</inertial>", re.S)


def outside(content):
    """The bytes that do not belong to an <inertial>."""
    return INERTIAL.sub(b"|", content)


def test_mujoco_reads_the_stated_base_parameters(exported, found, robot):
    model = mujoco.MjModel.from_xml_path(exported.file)
    parameters = base_parameters(robot, model)
    value = parameters.values(standard_parameters(model))
    assert np.abs(value - exported.base_parameters).max() < 1e-9
    # Estimate and CAD by their weights, as one least-squares problem.
    prior = cad_prior(parameters, standard_parameters(robot.model))
    weights = [np.linalg.inv(covariance) for covariance in (found.full.covariance, prior.covariance)]
    wanted = np.linalg.solve(sum(weights), weights[0] @ found.full.value + weights[1] @ prior.center)
    assert np.abs(value - wanted).max() < 1e-6
    assert model.body_mass.sum() == pytest.approx(exported.total_mass.value, abs=1e-9)
    moments = np.sort(model.body_inertia[1:], axis=1)
    assert (moments > 0).all()
    assert (moments[:, 0] + moments[:, 1] > moments[:, 2]).all()


def test_only_the_inertias_change(exported, robot):
    path = robot.model_file
    before, after = path.read_bytes(), Path(exported.file).read_bytes()
    assert before != after
    assert outside(before) == outside(after)
    assert len(INERTIAL.findall(after)) == robot.model.nbody - 1


def test_the_document(exported, found, robot):
    told = exported.to_json()
    json.dumps(told)
    assert {row["link"] for row in told["links"]} == {
        robot.model.body(k).name for k in range(1, robot.model.nbody)
    }
    assert all(0 <= row["mass_data_share"] <= 1 for row in told["links"])
    assert 0 < told["misfit_in_standard_errors"] < 5
    m, full = found.measurements, found.full
    assert told["total_mass"] == {"value": m.weighed_mass[0], "source": "weighed"}
    com = found.parameters.regressor(m.joint_angles, m.support) @ full.value
    off = contact_pressure(observe(m, nominal_robot(robot))).center - com
    assert told["constant"]["mean"] == pytest.approx(off.mean(axis=0), abs=1e-6)
    assert told["constant"]["share"] == pytest.approx(off.mean(axis=0) ** 2 / (off**2).mean(axis=0), rel=1e-3)
    assert Path(told["file"]).name == "identified.xml"
    text = repr(exported)
    assert "standard errors from those of the estimate" in text
    assert "right_lower_leg" in text


@pytest.mark.parametrize("name", ["tulip", "humanoid", pytest.param("humanoid_CMU", marks=pytest.mark.slow)])
def test_urdf_of_an_mjcf(name, robot, foreign, found, tmp_path):
    """MuJoCo moves the centre of mass of the URDF as that of the exported MJCF."""
    described = robot if name == "tulip" else foreign[name]
    rng = np.random.default_rng(2)
    wanted = imagined(found, described, draw_robot(described.model, 0.1, rng))
    for ending in ("xml", "urdf"):
        made = export_model(wanted, described, tmp_path / f"a.{ending}")
    spec = mujoco.MjSpec.from_file(str(tmp_path / "a.urdf"))
    spec.compiler.fusestatic = False
    models = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml")), spec.compile()
    assert models[1].body_mass.sum() == pytest.approx(models[0].body_mass.sum(), abs=1e-6)
    for _ in range(10):
        angles = dict(zip(joint_names(described.model), rng.uniform(-1, 1, 100), strict=False))
        one, other = (center_of_mass(model, angles) for model in models)
        assert np.abs(one - other).max() < 1e-9 + 1e-6 * (models[1].nbody > models[0].nbody)
    read = PublishedLinks(tmp_path / "a.urdf", described)
    sums = read.by_link(described.model.nbody - 1)
    again = wanted.parameters.values(sums[:, 3, [3, 0, 1, 2]])
    assert np.abs(again - made.base_parameters).max() < 1e-9


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """A published URDF whose links are partly fixed to each other, and the robot made of it."""
    folder = tmp_path_factory.mktemp("published")
    urdf = write_published(folder / "source")
    return urdf, import_robot(urdf).write(folder / "robot")


def test_a_published_urdf_gets_the_inertias(published, found, tmp_path):
    urdf, robot = published
    wanted = imagined(found, robot, draw_robot(robot.model, 0.2, np.random.default_rng(4)))
    made = export_model(wanted, robot, tmp_path / "new.urdf", urdf)
    before, after = urdf.read_bytes(), (tmp_path / "new.urdf").read_bytes()
    assert outside(before) == outside(after)
    links = PublishedLinks(tmp_path / "new.urdf", robot)
    sums = links.by_link(robot.model.nbody - 1)
    assert np.abs(wanted.parameters.values(sums[:, 3, [3, 0, 1, 2]]) - made.base_parameters).max() < 1e-9
    written = [pseudo_inertia(one.mass, one.center, one.inertia) for one in made.links]
    assert np.abs(sums - np.array(written)).max() < 1e-9
    assert np.linalg.eigvalsh(links.pseudo).min() > 0
    assert links.names == PublishedLinks(urdf, robot).names
    assert any("meshes/torso.stl" in note for note in made.notes)
    beside = export_model(wanted, robot, urdf.with_name("new.urdf"), urdf)
    assert beside.notes == ()


def test_six_digits_of_a_turned_frame_are_still_the_same_robot(tmp_path):
    urdf = write_published(tmp_path / "source")
    head, waist, rest = urdf.read_text().partition('name="waist"')
    urdf.write_text(head + waist + rest.replace('rpy="0 0 0"', 'rpy="0.42 -0.42 0.18"', 1))
    robot = import_robot(urdf).write(tmp_path / "robot")
    assert "chest" in PublishedLinks(urdf, robot).names


def test_another_robots_urdf_is_refused(published, found, robot, tmp_path):
    urdf, _ = published
    with pytest.raises(tt.InputError, match="expected the file that the robot is made of"):
        export_model(found, robot, tmp_path / "new.urdf", urdf)


def test_an_inconsistent_estimate_is_told(found, robot, tmp_path):
    wanted = imagined(found, robot, standard_parameters(robot.model), error=1e-4)
    wanted.full.value[7] += 0.05
    with pytest.warns(tt.InputWarning) as warned:
        made = export_model(wanted, robot, tmp_path / "a.xml")
    far = made.misfit_in_standard_errors
    assert 50 < far < 500
    assert "No physically consistent robot" in str(warned[0].message)
    assert f"{far:.3g} standard errors from those of the estimate" in str(warned[1].message)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    value = base_parameters(robot, model).values(standard_parameters(model))
    assert np.linalg.norm(value - wanted.full.value) / 1e-4 == pytest.approx(far, rel=1e-5)


def test_text_of_every_kind(tmp_path):
    """Comments, quotes that hold '>', empty elements, end tags, CRLF, bodies without an inertia."""
    text = (
        b'<mujoco>\r\n <!-- <inertial pos="0 0 0"/> -->\r\n <worldbody>\r\n'
        b'  <body name="a" user="1">\r\n'
        b'   <inertial pos="1 0 0" mass="1" diaginertia="1 1 1"></inertial >\r\n'
        b"   <body name='b>'\r\n pos='0 0 1'><freejoint/>\r\n    <body name=\"c\"/><inertial mass='2' "
        b'pos="0 0 0" diaginertia="1 1 1"/></body>\r\n  </body>\r\n  <body name="d">\r\n  </body>\r\n'
        b" </worldbody>\r\n</mujoco>"
    )
    one = pseudo_inertia(1.5, np.array([0.25, 0, 0]), np.eye(3))
    changed = with_inertias(text, dict.fromkeys(("a", "b>", "c", "d"), one), tmp_path / "x.xml")
    new = b'<inertial pos="0.25 0.0 0.0" mass="1.5" fullinertia="1.0 1.0 1.0 0.0 0.0 0.0"/>'
    assert changed.count(new) == 4
    assert b'<!-- <inertial pos="0 0 0"/> -->' in changed
    assert b'<body name="c">' + new + b"</body>" in changed
    assert b'<body name="d">\r\n    ' + new + b"\r\n  </body>" in changed
    assert re.sub(rb"\s*" + re.escape(new), b"", changed).count(b"inertial") == 1
    again = with_inertias(changed, dict.fromkeys(("a", "b>", "c", "d"), one), tmp_path / "x.xml")
    assert again == changed
    refuse('found no <body name="e">', with_inertias, text, {"e": one}, tmp_path / "x.xml")


def test_a_body_in_an_included_file_is_refused(robot, found, edited_tulip, tmp_path):
    leg = re.search(
        r' *<body name="left_hip_yaw".*</body>\n(?=    </body>\n  </worldbody>)',
        robot.model_file.read_text(),
        re.S,
    )
    assert leg is not None
    folder = edited_tulip(built=False).folder
    (folder / "leg.xml").write_text(f"<mujocoinclude>{leg[0]}</mujocoinclude>")
    change_texts(folder, [f'tulip.xml: {leg[0]} => <include file="leg.xml"/>'])
    other = tt.load_robot(folder / "tulip.toml")
    refuse('found no <body name="left_hip_yaw"> ... included', export_model, found, other, tmp_path / "a.xml")


def test_what_was_adopted_and_is_not_in_the_file_is_told(found, robot, tmp_path):
    known = tt.Laboratory(robot, "force-plate").with_known("encoder-offset:right_knee=0.01").known
    made = export_model(found, robot, tmp_path / "a.xml", adopted=known)
    assert any("right_knee" in note and "not in the file" in note for note in made.notes)


def test_a_source_whose_compiler_overrules_the_inertias_is_refused(found, robot, tmp_path):
    source = shutil.copytree(robot.model_file.parent, tmp_path / "robot") / "changed.xml"
    text = re.sub(r' inertiafromgeom="[^"]*"', "", robot.model_file.read_text())
    source.write_text(text.replace("<compiler ", '<compiler inertiafromgeom="true" ', 1))
    with pytest.raises(tt.InputError, match=r"a setting of the file overrules inertias .*inertiafromgeom"):
        tt.export_model(found, robot, out=tmp_path / "out.xml", source=source)
    assert not (tmp_path / "out.xml").exists()


def test_few_rows_move_no_mass_far_from_cad(run, robot, tmp_path):
    few = tt.identify(run.measurements.take(np.arange(28)), robot)
    made = tt.export_model(few, robot, out=tmp_path / "a.xml")
    assert all(0.7 < link.mass / link.mass_cad < 1.4 for link in made.links if link.mass_cad)

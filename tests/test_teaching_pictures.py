"""The teaching pictures of the docs: they exist, they are small, and their figures are right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

pytest.importorskip("matplotlib")

from studies.teaching.ankle_roll import DIFFERENCE, SUM, half_width
from studies.teaching.ensemble import ellipse, share_inside
from studies.teaching.signature import example, examples, lever, noisy_error, scatter_about_line, signature
from studies.teaching.stepping import MOST, way_through
from studies.teaching.variables import VARIABLES
from tests.effect_changes import first
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.sim.path import ClosedChain

DOCS = Path(__file__).resolve().parents[1] / "docs" / "pictures"
LARGE = ("signatures.png", "cloud.png", "ankle-roll.png")


def test_the_film_loops_for_ten_seconds():
    with Image.open(DOCS / "plan.webp") as film:
        durations = [image.copy().info["duration"] for image in ImageSequence.Iterator(film)]
        assert film.info["loop"] == 0
        assert film.width == 640
    assert 8000 < sum(durations) < 12000
    assert (DOCS / "plan.webp").stat().st_size < MOST


@pytest.mark.parametrize("name", LARGE)
def test_large_pictures_are_sharp_and_small(name):
    with Image.open(DOCS / name) as picture:
        assert picture.width == 1600
    assert (DOCS / name).stat().st_size < 300_000


def test_every_effect_has_a_picture_without_references():
    assert {path.stem for path in (DOCS / "signatures").iterdir()} == set(catalogue())
    for path in (DOCS / "signatures").glob("*.svg"):
        text = path.read_text()
        assert path.stat().st_size < 40_000, path.name
        links = [part.split('"')[0] for part in text.split('href="')[1:]]
        assert links
        assert all(link.startswith("#") for link in links), path.name


def test_the_ellipse_is_the_covariances():
    covariance, center = np.array([[4.0, -1.5], [-1.5, 1.0]]), np.array([3.0, -2.0])
    around = ellipse(center, covariance) - center
    # chi-square of two degrees of freedom: 95 % below -2 ln 0.05
    distance = np.einsum("ki,ij,kj->k", around, np.linalg.inv(covariance), around)
    assert distance == pytest.approx(-2 * np.log(0.05))
    drawn = np.random.default_rng(5).multivariate_normal(center, covariance, 20_000)
    assert share_inside(drawn, center, covariance) == pytest.approx(0.95, abs=0.005)


def test_opposed_errors_leave_the_sum_known():
    covariance = 100.0 * np.array([[1.0, -0.99], [-0.99, 1.0]])
    assert half_width(covariance, SUM) == pytest.approx(1.96 * np.sqrt(2.0))
    assert half_width(covariance, DIFFERENCE) == pytest.approx(1.96 * np.sqrt(398.0))


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


def test_the_straight_line_is_the_own_quantitys(robot, two):
    found = signature(EffectInstance.parse("tilt=0.01,0.02", robot), robot, two)
    other = found.observed.joint_angles[:, 0]
    assert scatter_about_line(found.observed.height, found.error[:, 0]) < 0.01
    assert scatter_about_line(other, found.error[:, 0]) > 0.1


def test_noise_is_added_to_the_signature(robot, two):
    instance = EffectInstance.parse("tilt=0.01,0.02", robot)
    exact, (observed, noisy) = (
        signature(instance, robot, two).error,
        noisy_error(instance, robot, two, "force-plate"),
    )
    assert len(noisy) == len(observed) >= len(exact)
    assert 0.05 < np.abs(noisy.mean(axis=0) - exact.mean(axis=0)).max() < 2.0


def test_there_is_an_example_of_every_effect(robot):
    found = examples(robot)
    assert [one.effect.name for one in found] == list(catalogue())
    assert set(VARIABLES) <= set(catalogue())
    for one in found:
        assert EffectInstance.parse(str(one), robot, (1, 2, 3)).label == one.label
    assert example(catalogue()["cell-tare"], robot).values == (1.645,)


def test_an_effect_of_the_dynamics_is_predicted(robot, two):
    assert not signature(example(catalogue()["unsettled"], robot), robot, two).simulated


def test_the_film_holds_the_planned_postures(robot, plan):
    few = first(plan, 2).take(np.array([0, 1, 5, 6]))
    way = way_through(few, ClosedChain(robot.model, robot), images=3)
    assert way.posture[way.held].tolist() == [1, 2, 3, 4]
    assert way.plan.joint_angles[way.held] == pytest.approx(few.joint_angles)
    # Two movements of three images; none from one placement to the next.
    assert way.held.tolist() == [True, *3 * [False], True, True, *3 * [False], True]
    chain = ClosedChain(robot.model, robot)
    for row in np.flatnonzero(~way.held):
        pose = chain.swing_pose(way.plan.joint_angles[row])
        assert pose == pytest.approx(way.plan.swing_pose[row], abs=1e-4)

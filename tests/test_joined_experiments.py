"""Several experiments with one robot: manipulations, sessions, known masses, and what is refused."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from tests.edited_rows import within
from tests.first_look import cases
from tests.test_refusals import change_document
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import removed
from tulip_testbed.effects.lasting import acting, arranged, epochs, targets_over
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import residuals, residuals_in_use
from tulip_testbed.measurements import Experiment, joined
from tulip_testbed.measurements.cells import CELLS
from tulip_testbed.measurements.joined import read_written, separate, write_experiments
from tulip_testbed.measurements.manipulations import arrangement_of

CABLE, LEFT = "cable removed", "left plate turned by 180 deg"
MASS = "known mass 2 kg at torso (0.1, -0.05, 0.3)"


@pytest.fixture(scope="module")
def lab(robot) -> tt.Laboratory:
    return tt.Laboratory(robot, sensors="ideal")


def measured(laboratory, few, *manipulations, session="one", seed=3):
    made = laboratory.manipulated(*manipulations, session=session)
    return made.run(few, seed=seed, engine="statics", workers=1).measurements


@pytest.fixture(scope="module")
def pair(robot, few):
    noisy = tt.Laboratory(robot, sensors="force-plate")
    return [measured(noisy, few), measured(noisy, few, CABLE, seed=4)]


@pytest.mark.parametrize(
    ("texts", "cell", "there"),
    [
        (["plates exchanged"], "right.front_left", "left.front_left"),
        ([LEFT], "left.front_right", "left.rear_left"),
        ([LEFT], "right.front_right", "right.front_right"),
        # The left place holds the right plate when it is turned.
        (["plates exchanged", LEFT], "right.front_left", "left.rear_right"),
        (["plates exchanged", LEFT], "left.front_left", "right.front_left"),
        # A turned robot finds the right plate's front left cell behind and to the right, under its left foot.
        (["robot turned by 180 deg"], "right.front_left", "left.rear_right"),
    ],
)
def test_a_device_is_where_it_was_put(texts, cell, there):
    assert CELLS[arrangement_of(texts).place_of[CELLS.index(cell)]] == there


def test_the_room_turns_for_a_turned_robot_and_a_cable_can_be_removed():
    tether, tilt = catalogue()["tether"], catalogue()["tilt"]
    turned = Experiment("", ("robot turned by 180 deg",))
    assert arranged(tilt, "", (0.01, -0.02), turned) == ("", (-0.01, 0.02))
    assert arranged(tether, "", (3.0, 1.0), Experiment("", (CABLE,))) is None
    assert arranged(tilt, "", (0.01, 0.0), Experiment("", (CABLE,))) == ("", (0.01, 0.0))


def test_swapped_cells_stay_swapped_on_a_turned_plate():
    swapped = catalogue()["swapped-cells"]
    assert arranged(swapped, "left", (0.0, 1.0), Experiment("", (LEFT,))) == ("left", (2.0, 3.0))
    exchanged = Experiment("", ("plates exchanged",))
    assert arranged(swapped, "left", (0.0, 3.0), exchanged) == ("right", (0.0, 3.0))


def test_a_turned_plate_turns_what_lies_along_its_axes():
    turned, exchanged = Experiment("", (LEFT,)), Experiment("", ("plates exchanged",))
    cell, sides = catalogue()["cell-position"], catalogue()["cell-side-force"]
    assert arranged(cell, "left.front_left", (0.01, -0.02), turned) == ("left.rear_right", (-0.01, 0.02))
    assert arranged(cell, "left.front_left", (0.01, 0.02), exchanged) == ("right.front_left", (0.01, 0.02))
    assert arranged(sides, "left", (0.1, -0.2), turned) == ("left", (-0.1, 0.2))
    assert arranged(sides, "right", (0.1, -0.2), turned) == ("right", (0.1, -0.2))
    bent = arranged(catalogue()["plate-map"], "left", (0.01, 0, 0, 0, 0, 0.02), turned)
    assert bent == ("left", (-0.01, 0, 0, 0, 0, -0.02))  # the square of a place has no sign


def test_what_belongs_to_a_session_has_a_target_in_each():
    tare, offset = catalogue()["cell-tare"], catalogue()["encoder-offset"]
    same = (Experiment("a"), Experiment("a", (LEFT,)))
    assert targets_over(tare, ("left.front_left",), same) == ("left.front_left",)
    other = (Experiment("a"), Experiment("b"), Experiment("a"))
    assert targets_over(tare, ("left.front_left",), other) == ("left.front_left@1", "left.front_left@2")
    assert epochs(catalogue()["tilt"].lasting, "", (Experiment(), Experiment())) == (1, 2)
    assert epochs(catalogue()["cell-gain"].lasting, "left.front_left", other) == (1, 1, 1)
    zeroed = (Experiment("a"), Experiment("a", ("encoder re-zeroed: right_knee",)))
    assert targets_over(offset, ("right_knee", "left_knee"), zeroed) == (
        *("right_knee@1", "right_knee@2"),
        "left_knee",
    )
    assert acting(offset, "right_knee@2", (0.01,), zeroed, 0) is None
    assert acting(offset, "right_knee@2", (0.01,), zeroed, 1) == ("right_knee", (0.01,))


def test_joined_experiments_come_apart_again(pair):
    whole = joined(pair)
    assert len(whole) == len(pair[0]) + len(pair[1])
    first, second = (set(whole.placement[whole.experiment == k]) for k in (0, 1))
    assert not first & second
    assert (np.diff(whole.time) > 0).sum() >= len(whole) - 1
    for one, again in zip(pair, separate(whole), strict=True):
        assert np.array_equal(one.cell_forces, again.cell_forces)
        assert again.experiments == one.experiments


def test_a_joined_run_folder_is_read_as_it_was_written(pair, tmp_path):
    whole = joined(pair)
    write_experiments(tmp_path / "measurements", whole)
    again = read_written(tmp_path / "measurements")
    assert np.array_equal(whole.placement, again.placement)
    assert np.array_equal(whole.cell_forces, again.cell_forces)
    assert again.experiments == whole.experiments
    assert again.weighed_mass == pytest.approx(whole.weighed_mass)


@pytest.mark.parametrize("known", [(True,), (False,), (True, False)], ids=["alone", "old", "joined"])
def test_jerks_of_forces_are_kept_by_each_experiment(robot, tmp_path, known):
    """An older folder has no column of them: there they count as zero, and elsewhere as they are."""
    plan, rng, written = tt.plans.mixed, np.random.default_rng(1), []
    feet = tt.Laboratory(robot, sensors="foot-ft")
    for k, holds in enumerate(known):
        m: Any = measured(feet, plan.take(plan.support == "right"), session=str(k), seed=k)
        parts = {f"joint_{name}": np.ones_like(m.joint_angles) for name in ("rates", "accelerations")}
        parts |= {f"wrench_{name}": np.ones_like(m.wrenches) for name in ("rates", "accelerations")}
        parts["wrench_jerks"] = rng.normal(size=m.wrenches.shape) if holds else None
        written.append(dataclasses.replace(within("contacts", m, zero_sd=np.zeros((2, 6))), **parts))
        tt.write_measurements(tmp_path / str(k + 1), written[-1])
    read: Any = read_written(tmp_path)
    jerks = observe(read, nominal_robot(robot, "right")).motion.load_rates[:, 2]
    for k, one in enumerate(written):
        rows = read.of_experiment == k
        if known[k]:
            assert read.wrench_jerks[rows] == pytest.approx(one.wrench_jerks)
        assert jerks[rows].any() == known[k]
    assert (read.wrench_jerks is not None) == any(known)


def test_a_fault_moves_with_the_turned_plate_in_the_readings(lab, few):
    """The simulated readings of a turned plate, against the readings without fault and one sum by hand."""
    faulty = lab.with_effects("cell-gain:left.front_right=0.1")
    plain, turned = (measured(one, few, LEFT).cell_forces for one in (lab, faulty))
    by_hand = plain.copy()
    at = CELLS.index("left.rear_left")
    by_hand[:, at] *= 1.1
    assert turned == pytest.approx(by_hand, rel=1e-12)


QUICK = [
    ("cell-gain:left.front_right=0.05", LEFT),
    ("tilt=0.01,0.02", "robot turned by 180 deg"),
    ("encoder-offset:right_knee=0.01", "encoder re-zeroed: right_knee"),
    ("tether=5,2", MASS),
]
SLOW = [
    ("cell-tare:right.rear_left=2", "plates exchanged"),
    ("tether=3,-2", CABLE),
    ("encoder-slip:left_knee=0.01,0.5", "plates moved"),
    ("creep:left.rear_left=0.02,0.3", LEFT),
    ("cell-side-force:left=0.05,0.03", LEFT),
    ("rocking:left.rear_left=0.0003", LEFT),
    ("payload-step:torso=0.5,0.5", MASS),
]


@cases("effect, manipulation", QUICK, SLOW)
def test_an_effect_is_removed_from_both_experiments(nominal, lab, few, effect, manipulation):
    """Removal of the joint effect leaves what each experiment leaves by itself."""
    faulty = lab.with_effects(effect)
    both = [measured(faulty, few), measured(faulty, few, manipulation, seed=4)]
    whole = joined(both)
    instance = faulty.hidden[0]
    if "re-zeroed" in manipulation:
        instance = dataclasses.replace(instance, target="right_knee@1")
    clean = removed(observe(whole, nominal), [instance])
    plain = joined([measured(lab, few), measured(lab, few, manipulation, seed=4)])
    expected = observe(plain, nominal)
    rows = {key: k for k, key in enumerate(keys_of(plain))}
    kept = [(k, rows[key]) for k, key in enumerate(keys_of(whole)) if key in rows]
    assert len(kept) > 0.8 * len(whole)
    here, there = np.array(kept).T
    off = np.abs(residuals(clean, nominal.value)[here] - residuals(expected, nominal.value)[there])
    off = off * residuals_in_use(clean)[here] * residuals_in_use(expected)[there]
    assert off[:, :2].max() < 4e-4
    assert off[:, 2:5].max() < 0.25


def keys_of(m):
    """Name every row by its experiment, posture and number among the tries of the posture."""
    pairs = list(zip(m.experiment.tolist(), m.posture.tolist(), strict=True))
    return [(*pair, pairs[:k].count(pair)) for k, pair in enumerate(pairs)]


def test_a_known_mass_is_part_of_the_model(robot, nominal, lab, few):
    """The loaded robot is simulated as a robot with another torso; its own parameters are found again."""
    loaded: Any = joined([measured(lab, few), measured(lab, few, MASS, seed=4)])
    assert loaded.weighed_mass[0] == pytest.approx(robot.model.body_mass.sum(), abs=1e-6)
    observed = observe(loaded, nominal)
    found = residuals(observed, nominal.value)
    alone = residuals(observe(joined([measured(lab, few)]), nominal), nominal.value)
    rows = loaded.experiment == 1
    # MuJoCo's soft contacts leave some tenths of a millimetre; the mass by itself moves the centre by 10 mm.
    assert np.abs(found[rows, :2]).max() < 1.5 * np.abs(alone[:, :2]).max() + 1e-4
    assert np.abs(found[rows, 2]).max() < 0.05
    unknown = dataclasses.replace(loaded, experiments=(Experiment("one"), Experiment("one")))
    assert np.abs(residuals(observe(unknown, nominal), nominal.value)[rows, :2]).max() > 5e-3


def test_a_misspelt_key_of_a_manifest_is_named(pair, tmp_path):
    tt.write_measurements(tmp_path / "one", pair[0])
    change_document(tmp_path / "one" / "manifest.json", 'manipulation = ["cable removed"]', "cafe = 1")
    with pytest.warns(
        tt.InputWarning, match="'manipulation', which is not read; did you mean 'manipulations'"
    ) as w:
        tt.read_measurements(tmp_path / "one")
    assert not any("cafe" in str(one.message) for one in w)

"""The studies: their runner, hidden effects, and the signatures in the docs."""

import importlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies import runner, study_real_robots
from studies.hidden_effects.hiding import NOTHING, ONE, OUTSIDE, TWO, Case, Clearness, Truth
from studies.hidden_effects.judging import Found, Outcome, carry_out
from studies.hidden_effects.laboratories import LARGEST, USUAL, Built, draw_laboratory, tolerance_of
from studies.hidden_effects.outside_faults import FAULTS
from studies.hidden_effects.readings import READERS, Readings
from studies.runner import Settings
from studies.study_hidden_effects import figures
from studies.teaching.signature import example, examples
from studies.teaching.variables import VARIABLES
from tests.effect_changes import statically
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance, split_label
from tulip_testbed.effects.misreading import Misreading
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics


def test_every_study_has_a_module_and_a_sentence() -> None:
    found = runner.studies()
    assert {"hidden-effects", "planning", "watch"} <= found.keys()
    for name, sentence in found.items():
        module = importlib.import_module(f"studies.study_{name.replace('-', '_')}")
        assert sentence == str(module.__doc__).split("\n")[0]
        assert callable(module.study)
        assert isinstance(module.SETTINGS, Settings)


def test_half_of_the_families_are_absent_and_no_member_is_a_clear_fault(robot):
    drawn = [draw_laboratory(robot, "wii", np.random.default_rng(seed)) for seed in range(40)]
    families = [{split_label(label)[0] for label in built.effects} - {"tilt"} for built in drawn]
    assert 0.35 < np.mean([len(some) for some in families]) / (len(USUAL) - 1) < 0.65
    offsets = [values[0] for built in drawn for label, values in built.effects.items() if "offset" in label]
    sizes = np.abs(offsets) / tolerance_of("encoder-offset", "wii")
    assert sizes.max() <= LARGEST
    assert (sizes**4).mean() / (sizes**2).mean() ** 2 > 4  # 3 of a normal distribution


def test_the_readers_mean_what_the_catalogue_says(robot, twelve):
    rig = preset_rig("force-plate", robot)
    found = statically(rig, twelve, 1)
    for name, read in READERS.items():
        effect = catalogue()[name]
        assert isinstance(effect.mechanism, Misreading)
        target = effect.targets.of(robot, (3,))[-1]
        values = tuple(p.prior or p.grid[-1] for p in effect.parameters)
        readings = Readings(found, rig, twelve, 1)
        read(readings, target, values)
        mine, theirs = readings.measurements, effect.mechanism.apply(found, robot, target, values)
        for field in ("joint_angles", "cell_forces", "plate_poses"):
            change = np.abs(getattr(theirs, field) - getattr(found, field)).max()
            tolerance = 0.6 if name == "creep" else 1e-9  # when a load begins between two postures is assumed
            assert np.abs(getattr(mine, field) - getattr(theirs, field)).max() <= tolerance * change, name


def test_side_forces_and_tilt_are_those_of_the_simulation(rig, twelve):
    plain = statically(rig, twelve, 1)
    readings = Readings(plain, rig, twelve, 1)
    unbalanced = np.abs(readings.side.sum(axis=1)).max()  # the plates are turned a little
    assert unbalanced < 0.02 * np.abs(readings.side).max()
    readings.tilt(np.tile([0.004, -0.003], (len(plain), 1)))
    tilted = catalogue()["tilt"].inject(rig, "", (0.004, -0.003))
    (there,) = run_statics(solve_plan(tilted, twelve), [np.random.SeedSequence(1)], all_solved=True)
    kept = np.isin(there.measurements.time, plain.time)
    forces = there.measurements.cell_forces[kept]
    left, change = (np.abs(m.cell_forces - forces).max(axis=1) for m in (readings.measurements, plain))
    assert np.mean(left < 0.01 * change) > 0.95  # in the others the board stands on three cells


def test_a_posture_on_other_cells_shows_nothing(robot, twelve):
    """Without its twist it has fewer residuals than the others, and the rest is no signal."""
    clearness = Clearness(Built("force-plate", preset_rig("force-plate", robot), {}), twelve, 1)

    def unload(readings: Readings) -> None:
        readings.forces[5, 0, 2] = -30.0

    assert clearness.of(replace(clearness.plain, faults=(unload,))) == pytest.approx((0.0, 0.0), abs=1e-6)


@pytest.mark.slow
def test_a_case_is_carried_out_kept_and_reproduced(robot, plan, tmp_path):
    given = Case(ONE, "force-plate", ("encoder-gain",)), 4, 11, robot, plan
    done, kept = (runner.kept(tmp_path / "case.json", carry_out, *given) for _ in range(2))
    assert kept == done  # to the second of processor time
    again = carry_out(*given)
    assert replace(again, seconds=0.0) == replace(done, seconds=0.0)
    assert len(done.base) == len(done.held) == 25
    assert done.members["cell-gain"]


def made(arm: str, verdict: str, *names: str, hidden: tuple[str, ...] = (), **more: Any) -> Outcome:
    def some(label: str) -> tuple[float, ...]:
        return (0.1,) * len(catalogue()[label.split(":")[0]].parameters)

    found = tuple(Found(name, some(name)) for name in names)
    kinds = tuple(split_label(label)[0] for label in hidden)
    truth = Truth({label: some(label) for label in hidden})
    return replace(Outcome(Case(arm, "wii", kinds), 0, truth, verdict=verdict, found=found), **more)


def test_scores_of_outcomes_made_by_hand():
    gain, warm = (
        ("encoder-gain:left_knee",),
        Truth(outside="cell-warm:5=0.1", culprits=("cell:left.rear_right",)),
    )
    both = (*gain, "encoder-gain:right_knee")
    law = Found("law:cell:left.rear_right/time/sine", errs="cell:left.rear_right")
    outcomes = [
        made(NOTHING, "calibrated", members={"tilt": (True, False)}, held=(True, False), base=(1.0, -3.0)),
        made(NOTHING, "named", "tilt", held=(True, True), base=(1.0, 1.0)),
        made(NOTHING, "named", *gain, truth=Truth(large=gain)),  # that member is large indeed
        made(NOTHING, "unknown", held=(False,), base=(9.0,)),  # nobody trusts these base parameters
        made(ONE, "named", *gain, hidden=gain, sizes={gain[0]: (True,)}),
        made(ONE, "ambiguous", "tilt", hidden=gain),
        made(ONE, "calibrated", hidden=gain),
        made(TWO, "named", *both, hidden=both),
        made(TWO, "named", both[0], hidden=both),
        made(TWO, "named", *both, "tilt", hidden=both),
        made(OUTSIDE, "unknown", "tilt"),
        made(OUTSIDE, "described", truth=warm, found=(law,)),
        made(OUTSIDE, "described", truth=warm, found=(replace(law, errs="encoder:left_knee"),)),
        made(OUTSIDE, "none"),
        Outcome(Case(ONE, "wii"), 0, failed="the robot falls"),
    ]
    rows = {one.name: [sum(map(sum, one.by_laboratory)), len(one.by_laboratory)] for one in figures(outcomes)}
    assert rows["nothing hidden: named or described"] == [2, 4]
    assert rows["nothing hidden: `unknown`"] == [1, 4]
    assert rows["one clear effect, `wii`: first"] == [1, 3]
    assert rows["two of one kind: both named"] == [1, 3]
    assert rows["outside: neither `none` nor `calibrated`"] == [3, 4]
    assert rows["wrong and confident, all arms"] == [3, 14]
    assert rows["base parameters: r.m.s. error [s.e.]"][0] == 12.0
    assert rows["base parameters: intervals hold"][0] == 3
    assert rows["`tilt`: intervals hold"][0] == 1
    assert rows["cases without data"] == [1, 15]


@pytest.mark.parametrize(("quantity", "wrong"), [("cop", False), ("time", True)])
def test_a_law_of_the_place_of_the_load_says_that_the_map_of_a_plate_is_bent(robot, quantity, wrong):
    (waves,) = (fault for fault in FAULTS if fault.name == "plate-waves")
    truth = Truth(outside="plate-waves:4=0.007", culprits=waves.culprits(robot, 4))
    law = Found(f"law:plate:left/{quantity}/quadratic", errs="plate:left")
    assert made(OUTSIDE, "described", truth=truth, found=(law,)).wrong == wrong


DOCS = Path(__file__).resolve().parents[1] / "docs" / "pictures"


def test_every_effect_has_a_picture_without_references():
    assert {path.stem for path in (DOCS / "signatures").iterdir()} == set(catalogue())
    for path in (DOCS / "signatures").glob("*.svg"):
        text = path.read_text()
        assert path.stat().st_size < 40_000, path.name
        links = [part.split('"')[0] for part in text.split('href="')[1:]]
        assert links
        assert all(link.startswith("#") for link in links), path.name


def test_there_is_an_example_of_every_effect(robot):
    found = examples(robot)
    assert [one.effect.name for one in found] == list(catalogue())
    assert set(VARIABLES) <= set(catalogue())
    for one in found:
        assert EffectInstance.parse(str(one), robot, (1, 2, 3)).label == one.label
    assert example(catalogue()["cell-tare"], robot).values == (1.645,)


def test_a_record_is_audited_before_its_other_steps(monkeypatch, tmp_path):
    """However many processes there are: no step of a case runs beside its audit, whose folder it needs."""
    done = []

    def audit(robot, truth, folder):
        done.append("audit")
        (folder / study_real_robots.MEASURED).mkdir()
        return {}

    def predict(robot, truth, folder):
        done.append("predict")
        raise ValueError("an error of the tool")

    monkeypatch.setattr(study_real_robots, "STEPS", {"audit": audit, "predict": predict})
    monkeypatch.setattr(study_real_robots, "write_record", lambda *_, **__: runner.Settings(seed=0))
    monkeypatch.setattr(study_real_robots, "Truth", lambda **_: None)
    nobody: Any = None
    for _ in range(2):  # the second finds everything done
        study_real_robots.carry_out(nobody, 0, (), False, tmp_path / "case")
    assert done == ["audit", "predict"]
    assert "an error of the tool" in (tmp_path / "case" / "predict.json").read_text()

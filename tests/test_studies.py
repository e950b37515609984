"""The studies: their runner, hidden effects, and the signatures in the docs."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies import runner, study_campaign, study_check, study_hidden_effects
from studies.hidden_effects.hiding import (
    LEFT_OUT,
    NOTHING,
    OUTSIDE,
    PRIOR,
    SCATTER,
    SINGLE,
    TWO,
    Case,
    World,
    draw_trial,
)
from studies.hidden_effects.judging import Found, Outcome, carry_out
from studies.hidden_effects.outside_faults import FAULTS
from studies.runner import Settings, header, row
from studies.study_hidden_effects import SETTINGS, figures
from studies.teaching.signature import example, examples, lever, signature
from studies.teaching.variables import VARIABLES
from tests.effect_changes import first
from tulip_testbed.base.errors import InputError
from tulip_testbed.calibration.self_calibration import usual_tolerances
from tulip_testbed.discovery.unusual_members import STANDS_OUT
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.sensors import PRESETS
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> list[Settings]:
    """Put a study of one table in the place of `check`; return the list of the settings that it gets."""
    given: list[Settings] = []

    def study(settings: Settings) -> Iterator[str]:
        given.append(settings)
        yield header("a", "b")
        yield row(1, "two")

    monkeypatch.setattr(study_check, "study", study)
    return given


def test_every_study_has_a_module_and_a_sentence() -> None:
    found = runner.studies()
    assert {"atlas", "check", "hidden-effects", "verdict"} <= found.keys()
    for name, sentence in found.items():
        module = importlib.import_module(f"studies.study_{name.replace('-', '_')}")
        assert sentence == str(module.__doc__).split("\n")[0]
        assert callable(module.study)
        assert isinstance(module.SETTINGS, Settings)


def test_a_study_gets_its_own_settings_and_those_of_the_command(seen: list[Settings]) -> None:
    assert runner.main(["check"]) == 0
    assert runner.main(["check", "--seed", "7", "--size", "0.1", "--only", "wii"]) == 0
    assert seen[0] == study_check.SETTINGS
    assert (seen[1].seed, seen[1].count(300), seen[1].count(2), seen[1].only) == (7, 30, 1, ("wii",))


def test_the_file_holds_the_command_and_what_was_printed(
    seen: list[Settings], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a table.md"
    assert runner.main(["check", "--size", "0.5", "--out", str(out)]) == 0
    text = out.read_text()
    assert text == capsys.readouterr().out
    assert text.startswith(f"`python -m studies check --size 0.5 --out '{out}'` (seed 104)\n")
    assert "\n\n| a | b |\n|---|---|\n| 1 | two |\n\n" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["chek"], "unknown study 'chek'; did you mean 'check'? valid: atlas, campaign, check"),
        (["check", "--only", "wii", "kinect"], "unknown part 'kinect'; valid: wii, force-plate"),
    ],
)
def test_unknown_names_are_refused(
    arguments: list[str], message: str, seen: list[Settings], capsys: pytest.CaptureFixture[str]
) -> None:
    assert runner.main(arguments) == 2
    assert message in capsys.readouterr().err
    assert not seen


SMALL = replace(SETTINGS, seed=7, size=0.1)


@pytest.fixture(scope="module")
def world(robot, plan):
    return World(robot, first(plan, 12), "force-plate", 1.0)


def trial(case, world, seed=3):
    return draw_trial(case, world, seed, np.random.default_rng(seed))


def test_the_perfect_world_is_scale_zero(world):
    perfect = trial(Case(NOTHING), replace(world, imperfections=0.0)).laboratory
    assert perfect.hidden == ()
    ordinary = trial(Case(NOTHING), world).laboratory
    assert len(ordinary.hidden) > 50
    off = ordinary.true_base_parameters(world.plan) - perfect.true_base_parameters(world.plan)
    assert np.abs(off).max() > 1e-3
    scattered = trial(Case(SCATTER), world).laboratory.rig.sensors.placement_sd
    ratio = np.array(scattered) / np.array(PRESETS["force-plate"].placement_sd)
    assert ratio == pytest.approx(ratio[0])
    assert not 0.99 < ratio[0] < 1.01


def test_clear_effects_are_beyond_their_family_and_on_different_targets(world):
    made = trial(Case(TWO, ("encoder-offset", "encoder-offset"), 2.0), world)
    one, two = made.faults
    assert one.target != two.target
    measured = made.laboratory.run(world.plan, 3, "statics").measurements
    observed = observe(measured, nominal_robot(world.robot))
    tolerance = usual_tolerances(observed, None).value["encoder-offset"]
    assert all(abs(each.values[0]) >= STANDS_OUT * tolerance for each in made.faults)
    assert len(made.twins) == 2
    with pytest.raises(InputError, match="payload: no plausible size is clear"):
        trial(Case(SINGLE, ("payload",), 2.0), world)


@pytest.fixture(scope="module")
def plain(robot, two):
    return run_statics(solve_plan(preset_rig("ideal", robot), two), [np.random.SeedSequence(1)])[
        0
    ].measurements


@pytest.mark.parametrize("fault", FAULTS, ids=[fault.name for fault in FAULTS])
def test_a_fault_outside_the_catalogue_shows(fault, robot, two, plain):
    assert fault.name not in catalogue()
    rig = fault.inject(preset_rig("ideal", robot), 3, 4 * fault.amplitude)
    faulty = run_statics(solve_plan(rig, two), [np.random.SeedSequence(1)])[0].measurements
    kept = np.isin(plain.posture, faulty.posture)
    angles = np.abs(faulty.joint_angles - plain.joint_angles[kept]).max()
    forces = np.abs(faulty.cell_forces - plain.cell_forces[kept]).max()
    assert angles > 1e-4 or forces > 1e-2
    assert fault.right(robot, 3)


def test_a_case_that_cannot_be_built_is_told(world, monkeypatch):
    monkeypatch.setattr("studies.hidden_effects.judging.MOST_TRIES", 1)
    done = carry_out(Case(SINGLE, ("payload",), 2.0), 0, 1, world)
    assert "payload: no plausible size is clear" in done.failed


@pytest.mark.slow
@pytest.mark.parametrize("imperfections", [0.0, 1.0])
def test_a_case_is_carried_out_kept_and_reproduced(imperfections, world, tmp_path):
    here = replace(world, imperfections=imperfections)
    case = Case(SINGLE, ("encoder-gain",), 4.0)
    study_hidden_effects.kept(tmp_path, case, 4, 11, here)
    (path,) = tmp_path.iterdir()
    done = study_hidden_effects.DOCUMENT.validate_json(path.read_bytes())
    assert replace(carry_out(case, 4, 11, here), seconds=0.0) == replace(done, seconds=0.0)
    assert done.right_first
    assert len(done.base) == 25


def made(arm: str, verdict: str, *names: str, hidden: tuple[str, ...] = (), **more: Any) -> Outcome:
    def some(label: str) -> tuple[float, ...]:
        return (0.1,) * len(catalogue()[label.split(":")[0]].parameters)

    found = tuple(Found(name, some(name), (name,)) for name in names)
    values: dict[str, Any] = {"hidden": hidden, "values": tuple(map(some, hidden)), "found": found}
    values |= {"twins": tuple(() for _ in hidden)} | more
    return Outcome(Case(arm, multiple=2.0 if arm == SINGLE else 0.0), verdict=verdict, **values)


def test_scores_of_outcomes_made_by_hand():
    gain = ("encoder-gain:left_knee",)
    both = (*gain, "encoder-gain:right_knee")
    law = Found("tilt", (0.1, 0.1), ("tilt",), (("cell:left.front_left", "time"),))
    outcomes = [
        made(NOTHING, "calibrated", members=(True, True, False), base=(True, False)),
        made(NOTHING, "named", "tilt", base=(True, True)),
        made(PRIOR, "named", *gain, hidden=gain, sizes=(True,)),
        made(PRIOR, "calibrated", hidden=gain, calibrated=(Found(gain[0], (0.3,)),)),
        made(PRIOR, "calibrated", hidden=gain, calibrated=(Found(gain[0], (-0.3,)),)),  # the wrong sign
        made(PRIOR, "unknown", hidden=gain, base=(False,)),  # nobody trusts these base parameters
        made(SINGLE, "named", *gain, hidden=gain),
        made(SINGLE, "named", "tilt", hidden=gain),
        made(SINGLE, "ambiguous", "tilt", hidden=gain, twins=(("tilt",),)),
        made(TWO, "named", *both, hidden=both),
        made(TWO, "named", both[0], hidden=both),
        made(LEFT_OUT, "named", "tilt", hidden=("tether",), twins=(("tilt",),)),
        made(OUTSIDE, "unknown", "tilt"),
        replace(made(OUTSIDE, "described"), found=(law,), right=(("cell:left.front_left", "*"),)),
        made(OUTSIDE, "calibrated"),
        made(SCATTER, "none"),
        Outcome(Case(PRIOR), failed="the robot falls"),
    ]
    found = {one.name: (sum(one.hits), len(one.hits)) for one in figures(outcomes)}
    assert found["nothing hidden: wrongly named"] == (1, 2)
    assert found["95 % intervals of imperfections hold"] == (2, 3)
    assert found["95 % intervals of base parameters hold"] == (3, 4)
    assert found["size from the prior: right first, of those that show"] == (2, 3)
    assert found["from 2 MDE on, isolable: right first"] == (1, 2)
    assert found["from 2 MDE on: in the set"] == (1, 3)
    assert found["two effects: both found, nothing else"] == (1, 2)
    assert found["left out: `unknown`, a law or a twin"] == (1, 1)
    assert found["outside: `unknown` or a law"] == (2, 3)
    assert found["outside: the right law first"] == (1, 3)
    assert found["scattering plates: a gap is seen"] == (0, 1)
    assert found["wrong and confident, all cases"] == (4, 16)
    assert found["cases without data"] == (1, 17)
    (line,) = [one.line for one in figures(outcomes) if one.name == "nothing hidden: wrongly named"]
    assert (
        line
        == "| nothing hidden: wrongly named | 1 of 2 (0.500; 0.013 to 0.987) | at most 0.03 | **missed** |"
    )


def test_cells_that_are_swapped_are_the_right_ones_in_any_order():
    name = "swapped-cells"
    outcome = replace(
        made(SINGLE, "named", name, hidden=(name,)),
        values=((0.0, 2.0),),
        found=(Found(name, (2.0, 0.0), (name,)),),
    )
    assert outcome.exact
    assert not replace(outcome, found=(Found(name, (0.0, 1.0), (name,)),)).exact


@pytest.mark.slow
def test_tilt_against_tether_is_settled_by_removing_the_cable(robot):
    made = Laboratory(robot, "force-plate").with_effects("tether=5,0")
    found = study_campaign.carry_out(made, 3, placements=30)
    assert found.verdicts == ("ambiguous", "named")
    assert found.words == ("first experiment", "cable removed")
    assert found.right
    before, after = found.errors
    assert after < before


DOCS = Path(__file__).resolve().parents[1] / "docs" / "pictures"


def test_every_effect_has_a_picture_without_references():
    assert {path.stem for path in (DOCS / "signatures").iterdir()} == set(catalogue())
    for path in (DOCS / "signatures").glob("*.svg"):
        text = path.read_text()
        assert path.stat().st_size < 40_000, path.name
        links = [part.split('"')[0] for part in text.split('href="')[1:]]
        assert links
        assert all(link.startswith("#") for link in links), path.name


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


def test_there_is_an_example_of_every_effect(robot):
    found = examples(robot)
    assert [one.effect.name for one in found] == list(catalogue())
    assert set(VARIABLES) <= set(catalogue())
    for one in found:
        assert EffectInstance.parse(str(one), robot, (1, 2, 3)).label == one.label
    assert example(catalogue()["cell-tare"], robot).values == (1.645,)


def test_an_effect_of_the_dynamics_is_predicted(robot, two):
    assert not signature(example(catalogue()["unsettled"], robot), robot, two).simulated

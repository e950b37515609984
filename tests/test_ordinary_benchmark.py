"""The benchmark of an ordinary world: what it draws, and its scores for outcomes made by hand."""

import dataclasses
from collections import Counter
from typing import Any

import numpy as np
import pytest

from tulip_testbed.base.errors import InputError
from tulip_testbed.calibration.self_calibration import usual_tolerances
from tulip_testbed.discovery.unusual_members import STANDS_OUT
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.experiments.benchmark import ordinary_run
from tulip_testbed.experiments.benchmark.benchmark_tables import tables
from tulip_testbed.experiments.benchmark.case_outcome import Found, Outcome
from tulip_testbed.experiments.benchmark.cases import ORDINARY, OUTSIDE_ARM, Case, Settings
from tulip_testbed.experiments.benchmark.ordinary_cases import (
    CLEAR,
    NOTHING,
    PRIOR,
    SCATTER,
    TWICE,
    ordinary_cases,
)
from tulip_testbed.experiments.benchmark.ordinary_tables import ordinary_figures
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.sim.sensors import PRESETS

SETTINGS = Settings("force-plate", 7, 0.2, ORDINARY)


def test_the_arms_and_their_halves(robot, plan):
    every = ordinary_cases(SETTINGS, robot, plan)
    assert every == ordinary_cases(SETTINGS, robot, plan)
    count = Counter((c.arm, c.dynamics) for c in every)
    assert count == {
        (NOTHING, False): 12,
        (SCATTER, False): 8,
        (PRIOR, False): 24,
        (CLEAR, False): 24,
        (TWICE, False): 12,
        (OUTSIDE_ARM, False): 12,
        (NOTHING, True): 4,
        (PRIOR, True): 16,
    }
    for arm in (PRIOR, CLEAR, TWICE, OUTSIDE_ARM):
        half = [c.imperfect for c in every if c.arm == arm and not c.dynamics]
        assert sum(half) == len(half) / 2
    assert all(c.imperfect for c in every if c.arm == NOTHING)
    assert not {c.kinds[0] for c in every if c.arm == TWICE} & {"tilt", "sole-compliance", "cell-crosstalk"}


@pytest.fixture(scope="module")
def robot_and_plan(robot, plan):
    return robot, plan.take(plan.placement <= 12)


def trial(arm, kind, robot_and_plan, imperfect=True, seed=3):
    case = Case(arm, (kind,) if kind else (), imperfect=imperfect)
    robot, plan = robot_and_plan
    return ordinary_run._trial(case, seed, "force-plate", robot, plan, np.random.default_rng(seed))


def test_laboratories_are_what_their_arm_says(robot_and_plan):
    plain = trial(NOTHING, None, robot_and_plan)
    assert len(plain.laboratory.hidden) > 50
    assert not plain.hidden
    nominal = Laboratory(robot_and_plan[0], "force-plate").true_base_parameters(robot_and_plan[1])
    assert np.abs(plain.laboratory.true_base_parameters(robot_and_plan[1]) - nominal).max() > 1e-3
    one = trial(PRIOR, "encoder-gain", robot_and_plan)
    labels = [effect.label for effect in one.laboratory.hidden]
    assert len(set(labels)) == len(labels)
    assert one.hidden[0] in one.laboratory.hidden
    alone = trial(PRIOR, "encoder-gain", robot_and_plan, imperfect=False)
    assert alone.laboratory.hidden == alone.hidden
    scattered = trial(SCATTER, None, robot_and_plan).laboratory.rig.sensors.placement_sd
    ratio = np.array(scattered) / np.array(PRESETS["force-plate"].placement_sd)
    assert ratio == pytest.approx(ratio[0])
    assert not 0.99 < ratio[0] < 1.01


def test_clear_effects_are_beyond_their_family_and_on_different_targets(robot_and_plan):
    made = trial(TWICE, "encoder-offset", robot_and_plan)
    first, second = made.hidden
    assert first.target != second.target
    assert first.effect.name == second.effect.name == "encoder-offset"
    run = made.laboratory.run(robot_and_plan[1], 3, "statics")
    observed = observe(run.measurements, nominal_robot(robot_and_plan[0]))
    tolerance = usual_tolerances(observed, None).value["encoder-offset"]
    assert all(abs(one.values[0]) >= STANDS_OUT * tolerance for one in made.hidden)
    assert len(made.twins) == 2
    with pytest.raises(InputError, match="payload: no plausible size is clear"):
        trial(CLEAR, "payload", robot_and_plan)


def test_a_case_that_cannot_be_built_is_told(robot_and_plan, monkeypatch):
    monkeypatch.setattr(ordinary_run, "MOST_TRIES", 1)
    done = ordinary_run.carry_out(Case(CLEAR, ("payload",)), 0, 1, "force-plate", *robot_and_plan)
    assert "payload: no plausible size is clear" in done.failed


@pytest.mark.slow
def test_a_case_is_carried_out_and_reproduced(robot, plan):
    case = Case(PRIOR, ("cell-gain",), imperfect=True)
    first, again = (ordinary_run.carry_out(case, 4, 11, "force-plate", robot, plan) for _ in range(2))
    timeless = [dataclasses.replace(one, wall_s=0.0, cpu_s=0.0) for one in (first, again)]
    assert timeless[0] == timeless[1]
    assert first.hidden[0].startswith("cell-gain:")
    assert len(first.base) == 25
    assert len(first.members) > 10


def made(arm, verdict, *names, hidden=(), **more) -> Outcome:
    def some(label):
        return (0.1,) * len(catalogue()[label.split(":")[0]].parameters)

    found = tuple(Found(name, some(name), (0.0,), (0.2,), (name,)) for name in names)
    values: dict[str, Any] = {"hidden": hidden, "values": tuple(map(some, hidden))}
    values |= {"twins": tuple(() for _ in hidden)} | more
    kinds = tuple(h.split(":")[0] for h in hidden)
    return Outcome(0, arm, kinds, 0.0, False, found=found, verdict=verdict, **values)


def test_scores_of_outcomes_made_by_hand():
    gain = ("encoder-gain:left_knee",)
    two = ("encoder-gain:left_knee", "encoder-gain:right_knee")
    right_sign = (Found(gain[0], (0.3,), (0.1,), (0.5,), ()),)
    outcomes = [
        made(NOTHING, "calibrated", imperfect=True, members=(True, True, False), base=(True, False)),
        made(NOTHING, "named", "tilt", imperfect=True, base=(True, True)),
        made(PRIOR, "named", *gain, hidden=gain, coverage=(True,)),
        made(PRIOR, "calibrated", hidden=gain, calibrated=right_sign),
        made(PRIOR, "calibrated", hidden=gain),  # not seen: it counts neither way
        made(PRIOR, "unknown", hidden=gain, base=(False,)),  # nobody trusts these base parameters
        made(CLEAR, "named", *gain, hidden=gain),
        made(CLEAR, "named", "tilt", hidden=gain),
        made(CLEAR, "ambiguous", "tilt", hidden=gain, twins=(("tilt",),)),
        made(TWICE, "named", *two, hidden=two),
        made(TWICE, "named", two[0], hidden=two),
        made(OUTSIDE_ARM, "unknown", "tilt", hidden=()),
        made(OUTSIDE_ARM, "calibrated", hidden=()),
        made(SCATTER, "none"),
    ]
    found = {f.name: (f.value, f.count) for f in ordinary_figures(outcomes)}
    assert found["nothing hidden: wrongly named"] == (0.5, 2)
    assert found["ordinary imperfections: 95 % intervals hold"] == (pytest.approx(2 / 3), 3)
    assert found["base parameters: 95 % intervals hold"] == (0.75, 4)
    assert found["sizes from the prior: right first, of those that show"] == (pytest.approx(2 / 3), 3)
    assert found["clear: right first, isolable"] == (0.5, 2)
    assert found["two of one kind: both found, nothing else"] == (0.5, 2)
    assert found["outside: `unknown` or a law"] == (0.5, 2)
    assert found["outside: `unknown` or a law, of those that show"] == (1.0, 1)
    assert found["scattering plates: false alarms"] == (0.0, 1)
    assert found["wrong and confident, all arms"] == (pytest.approx(3 / 14), 14)
    titles = [table.title for table in tables(outcomes, ORDINARY)]
    assert titles == ["Figures, static laboratory", "Verdicts, static laboratory", "Wrong results"]
    (misses,) = [table for table in tables(outcomes, ORDINARY) if table.title == "Wrong results"]
    assert len(misses.rows) == 5

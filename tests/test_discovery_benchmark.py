"""The benchmark of the discovery: reproducible, resumable, its scores right for outcomes made by hand."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from tulip_testbed.cli.main import main
from tulip_testbed.discovery.detectability import noncentrality
from tulip_testbed.effects.catalogue import catalogue, effects_on
from tulip_testbed.effects.instance import split_label
from tulip_testbed.experiments.atlases.isolability import ISOLABLE
from tulip_testbed.experiments.benchmark import benchmark_run as run
from tulip_testbed.experiments.benchmark import cases as arms
from tulip_testbed.experiments.benchmark.benchmark_tables import files
from tulip_testbed.experiments.benchmark.case_outcome import Bias, Found, Outcome, outcome
from tulip_testbed.experiments.benchmark.cases import Case, Settings, cases
from tulip_testbed.experiments.benchmark.draw import MOST_PRIORS, draw_absorbed, draw_visible
from tulip_testbed.experiments.benchmark.outside_faults import OUTSIDE
from tulip_testbed.experiments.benchmark.score import figures
from tulip_testbed.experiments.benchmark.scoreboard import board
from tulip_testbed.sim.plan_folder import write_plan

SETTINGS = Settings("force-plate", 7, 0.01)
FEW = [
    Case(arms.NULL),
    Case(arms.SINGLE, ("cell-hysteresis",), 3.0),
    Case(arms.LEFT_OUT, ("thermal-gain-drift",), 3.0),
    Case(arms.OUTSIDE_ARM, ("cell-warm",), 8.0),
    Case(arms.ABSORBED, ("payload",)),
]


@pytest.fixture(scope="module")
def folder(plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plans") / "small"
    write_plan(folder, plan.take(plan.placement <= 6))
    return folder


@pytest.fixture(scope="module")
def small(folder):
    return board("force-plate", folder)


def test_all_arms_and_kinds_are_there(small):
    every = cases(SETTINGS, small)
    assert every == cases(SETTINGS, small)
    assert {c.arm for c in every} == {
        *(arms.NULL, arms.ROBOTS, arms.SINGLE, arms.SEVERAL, arms.LEFT_OUT, arms.OUTSIDE_ARM, arms.ABSORBED)
    }
    single = {c.kinds[0] for c in every if c.arm == arms.SINGLE and not c.dynamics}
    assert single == {effect.name for effect in effects_on(None, statics=True)} - {"payload"}
    for multiple in arms.MULTIPLES:
        assert any(c.multiple == multiple and c.arm == arms.SINGLE for c in every)
    assert all(c.dynamics for c in every if set(c.kinds) & set(arms.ONLY_DYNAMICS))
    assert cases(Settings("force-plate", 8, 0.01), small) != every


def test_sizes_are_multiples_of_what_can_be_found(small):
    rng = np.random.default_rng(3)
    signs = set()
    for _ in range(20):
        hidden = draw_visible(small, "encoder-offset", 2.0, rng)
        (candidate,) = [c for c in small.candidates if c.label == hidden.label]
        assert np.linalg.norm(hidden.signal) == pytest.approx(2 * small.wanted(candidate))
        assert abs(hidden.instance.values[0]) <= MOST_PRIORS * candidate.prior[0]
        signs.add(np.sign(hidden.instance.values[0]))
    assert signs == {-1.0, 1.0}
    assert all(draw_visible(small, "backlash", 1.0, rng).instance.values[0] > 0 for _ in range(10))
    assert not draw_absorbed(small, "payload", rng).signal.any()


def test_twins_are_what_looks_alike(small):
    hidden = draw_visible(small, "cell-tare", 2.0, np.random.default_rng(0))
    angles = small.angles(hidden.signal)
    assert angles[hidden.label] < 0.01
    twins = small.twins(hidden.signal, [hidden.label])
    plate, corner = hidden.instance.target.split(".")
    opposite = {"front_left": "rear_right", "front_right": "rear_left"}
    opposite |= {b: a for a, b in opposite.items()}
    assert f"cell-tare:{plate}.{opposite[corner]}" in twins
    assert all(angles[label] < ISOLABLE for label in twins)
    assert small.remainder(hidden.signal) == pytest.approx(0, abs=0.01)
    others = [label for label in angles if label != "cell-hysteresis"]
    alone = np.linalg.norm(hidden.signal) * np.sin(angles["cell-hysteresis"])
    assert small.remainder(hidden.signal, others) == pytest.approx(
        alone / np.sqrt(noncentrality(1, small.level))
    )


def test_every_fault_outside_the_catalogue_shows(small):
    assert not {o.name for o in OUTSIDE} & set(catalogue())
    for fault in (*OUTSIDE[:4], *OUTSIDE[-4:]):
        assert np.linalg.norm(small.signal(lambda rig, f=fault: f.inject(rig, 3, f.amplitude))) > 1


@pytest.mark.slow
def test_reproducible_for_any_number_of_workers_and_resumed(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "cases", lambda settings, made: FEW)
    one, two = tmp_path / "one", tmp_path / "two"
    first = run.benchmark(SETTINGS, one, 1, folder)
    run.benchmark(SETTINGS, two, 2, folder)
    (two / "runs" / "chunk-000002.parquet").unlink()
    assert [o.run for o in run.so_far(two)] == [0, 1, 3, 4]
    again = run.benchmark(SETTINGS, two, 1, folder)

    def timeless(o):
        return o.document() | {"wall_s": 0.0}

    assert [timeless(o) for o in again] == [timeless(o) for o in first]
    assert [o.run for o in first] == [0, 1, 2, 3, 4]
    null, single, left_out, outside, absorbed = first
    assert single.hidden == ("cell-hysteresis",)
    assert single.predicted > 0.99
    assert single.held is not None
    assert single.bias is not None
    assert outside.hidden[0].startswith("cell-warm:")
    assert "thermal-gain-drift" not in [label for t in left_out.found for label in t.alike]
    assert null.verdict == absorbed.verdict == "none"
    assert absorbed.unseen


def some(label: str) -> tuple[float, ...]:
    """Values of an effect."""
    return (0.1,) * len(catalogue()[split_label(label)[0]].parameters)


def made(verdict: str, *names: str, hidden: tuple[str, ...] = ("tilt",), arm=arms.SINGLE, **more) -> Outcome:
    found = tuple(Found(n, some(n), (0.0,), (0.2,), (n, *more.pop("alike", ()))) for n in names)
    values: dict[str, Any] = {
        "kinds": tuple(split_label(h)[0] for h in hidden),
        "multiple": 2.0,
        "dynamics": False,
    }
    values |= {"values": tuple(map(some, hidden))}
    values |= {"hidden": hidden, "twins": tuple(() for _ in hidden), "found": found, "verdict": verdict}
    values |= {"run": 0, "arm": arm} | more
    return Outcome(**values)


def by_name(outcomes):
    return {f.name: f for f in figures(outcomes)}


def test_scores_of_outcomes_made_by_hand():
    null = {"hidden": (), "arm": arms.NULL}
    found = by_name([made("none", **null)] * 49 + [made("unknown", **null)])
    alarms = found["false alarms on nulls"]
    assert (alarms.value, alarms.count, alarms.met) == (0.02, 50, True)
    # Clopper and Pearson (1934): 1 of 50
    assert (alarms.low, alarms.high) == pytest.approx((0.000506, 0.106469), abs=1e-6)

    right, twin, wrong = (
        made("named", "tilt", coverage=(True,), bias=Bias(3.0, 1.0, 0.2)),
        made("ambiguous", "tether", alike=("tilt",), twins=(("tether",),)),
        made("named", "sole-compliance", coverage=(), bias=Bias(3.0, 1.0, 1.5)),
    )
    found = by_name([right, twin, wrong])
    assert found["right name first, isolable, from 2 MDE on"].value == 0.5
    assert found["right name first, all, from 2 MDE on"].value == pytest.approx(1 / 3)
    assert found["true effect in the set, from 2 MDE on"].value == pytest.approx(2 / 3)
    assert found["one wrong name, confidently, of all single effects"].value == pytest.approx(1 / 3)
    assert found["median size of the set"].value == 1
    assert found["95 % intervals of the size hold it"].count == 1
    assert found["median part of the parameters' bias removed"].value == pytest.approx(0.15)
    assert found["false alarms on nulls"].met is None


def test_who_says_unknown_has_not_said_the_name():
    found = by_name([made("unknown", "tilt"), made("refused")])
    for name in ("right name first, all, from 2 MDE on", "true effect in the set, from 2 MDE on"):
        assert (found[name].value, found[name].count) == (0.0, 2)
    both = {"hidden": ("tilt", "tether"), "arm": arms.SEVERAL}
    found = by_name([made("unknown", "tilt", "tether", **both), made("ambiguous", "tilt", "tether", **both)])
    assert found["pairs: each in a set"].value == 0.5
    assert found["pairs: both found first, nothing else"].value == 0.5
    assert found["pairs: the same, and both named"].value == 0.0


def test_exchanged_cells_are_the_right_ones_in_any_order():
    cells = "swapped-cells:left"
    for chosen, share in (((1.0, 3.0), 1.0), ((3.0, 1.0), 1.0), ((1.0, 2.0), 0.0)):
        one = made("named", cells, hidden=(cells,), values=((1.0, 3.0),))
        one = dataclasses.replace(one, found=(dataclasses.replace(one.found[0], values=chosen),))
        found = by_name([one])
        assert found["right name first, all, from 2 MDE on"].value == share
        assert found["one wrong name, confidently, of all single effects"].value == 1 - share


def test_scores_of_what_is_left_out_outside_and_several():
    left = {"arm": arms.LEFT_OUT}
    found = by_name(
        [
            made("unknown", **left),
            made("named", "tether", twins=(("tether",),), **left),
            made("named", "tether", **left),
            made("ambiguous", "tether", "plate-yaw:left", twins=(("tether",),), **left),
        ]
    )
    assert found["left out: unknown, or a twin said"].value == 0.5
    assert found["left out: wrong name that is no twin's"].value == 0.25
    assert found["left out: the same, where the closest entry leaves 1 MDE"].count == 0
    both = {"hidden": ("tilt", "tether"), "arm": arms.SEVERAL}
    found = by_name(
        [
            made("named", "tether", "tilt", **both),
            made("named", "tether", "tilt", "backlash:right_knee", **both),
        ]
    )
    assert found["pairs: both found first, nothing else"].value == 0.5
    assert found["pairs: each in a set"].value == 1
    outside = {"arm": arms.OUTSIDE_ARM}
    found = by_name([made("unknown", "tilt", **outside), made("named", "tilt", **outside)])
    assert found["unknown or a law said, outside the catalogue"].value == 0.5
    assert found["wrong name, outside"].value == 0.5


def test_files_and_documents():
    single = made("named", "tilt", coverage=(True,), held=(2.0, 1.0, 1.1), bias=Bias(3.0, 1.0, 0.2))
    assert outcome(json.loads(json.dumps(single.document()))) == single
    written = files([single, made("none", hidden=(), arm=arms.NULL)], "2 cases")
    assert written["report.md"].startswith("2 cases\n")
    assert (
        "| right name first, isolable, from 2 MDE on | 1 (0.025 to 1) | 1 | at least 0.95 | met, not shown |"
        in written["report.md"]
    )
    assert "tilt,2.0,named,tilt,1" in written["confusion.csv"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--size", "0"], "--size: found 0, expected more than 0 and at most 10"),
        (["--seed", "-1"], "--seed: found -1, expected 0 or more"),
        (["--workers", "0"], "--workers: found 0, expected 1 or more"),
    ],
)
def test_refused(options, message, tmp_path, capsys):
    assert main(["benchmark", "discover", "--out", str(tmp_path / "new"), *options]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "new").exists()

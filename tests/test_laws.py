"""Laws: the grammar, their removal, the search and what it says."""

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.effect_changes import agreement, changes, measured, statically
from tulip_testbed.cli.main import main
from tulip_testbed.discovery.candidate_search import CandidateSearch, Judged, first_calibration
from tulip_testbed.discovery.candidates import Candidate, Fitted
from tulip_testbed.discovery.columns import candidate_columns
from tulip_testbed.discovery.discover import AGREEING, _inexact, _verdict, discover
from tulip_testbed.discovery.joint_fit import Data
from tulip_testbed.discovery.law_candidates import _columns, law_candidates
from tulip_testbed.discovery.law_search import select_laws
from tulip_testbed.discovery.nominal_laboratory import simulated, without_noise
from tulip_testbed.discovery.patterns import Pattern
from tulip_testbed.effects.instance import EffectInstance, injected, removed
from tulip_testbed.effects.laws import sentence_of
from tulip_testbed.effects.true_robot import true_base_parameters
from tulip_testbed.experiments.discovery_curves import law_curves
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.rig_folder import read_rig
from tulip_testbed.identification.estimators import MIXED_MODEL
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_noise import noise_of
from tulip_testbed.pages.discovery_page import discovery_page
from tulip_testbed.pages.page import html
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import preset_rig

HIDDEN = "law:encoder:right_knee/own-angle/sine=0.004,0.003,1,0,2"


def test_a_law_of_a_torque_is_removed(robot, nominal, noiseless, few):
    """Laws of what is read: tests/test_instrument_effects.py."""
    law = EffectInstance.parse("law:encoder:left_knee/own-torque/quadratic=0.004,0.003,-40,60", robot)
    plain, faulty = statically(noiseless, few), statically(injected(noiseless, [law]), few)
    true, read = (observe(one, nominal) for one in (plain, faulty))
    wrong = np.abs(read.joint_angles - true.joint_angles).max()
    left = removed(read, [law]).joint_angles - true.joint_angles
    assert wrong > 1e-4
    assert np.abs(left).max() < 1e-4 * wrong


@pytest.mark.slow
@pytest.mark.parametrize(
    "text",
    [
        "law:force:right_lower_leg/nothing/constant=3,-2,4",
        "law:force:torso/time/step=2,3,-4,0.5",
        "law:force:torso/time/linear=2,3,-4",
    ],
)
def test_a_force_is_predicted_as_it_acts(text, robot, nominal, noiseless, few):
    law = EffectInstance.parse(text, robot)
    base, pulled = statically(noiseless, few), statically(injected(noiseless, [law]), few)
    simulated, predicted = changes(nominal, base, pulled, law.effect, law.target, law.values, absorbed=False)
    cosine, slope = agreement(np.array(simulated)[:, :3], np.array(predicted)[:, :3])
    assert cosine > 0.99
    assert slope == pytest.approx(1.0, abs=0.05)


def test_a_search_recalls_what_it_computed_of_the_same_effects_and_start(robot, plan, nominal):
    observed = observe(measured(robot, plan.take(plan.placement <= 8), "wii"), nominal)
    search = CandidateSearch.of(observed)
    start = first_calibration(search.observed)
    (offset,) = (c for c in search.candidates if c.label == "encoder-offset:right_knee")
    terms, others = ((Fitted(offset, 0, np.array([size])),) for size in (0.0, 1e-3))
    covariance, part = start.linear.covariance, search.of_part(observed, np.arange(len(observed)))
    found = search.calibration(terms, start, covariance, 1)
    assert search.calibration(list(terms), start, covariance, 1) is found
    assert search.fits(start, ())[0] is search.fits(start, [])[0]
    assert search.calibration(others, start, covariance, 1) is not found
    assert search.calibration(terms, replace(start), covariance, 1) is not found
    assert search.calibration(terms, start, None, 1) is not found
    assert part.calibration(terms, start, covariance, 1) is not found


def test_a_judgement_with_a_family_at_its_bound_is_made_afresh(robot, monkeypatch):
    """Members that hold a gross fault come to rest at their bounds, far below the mode of what is missing."""
    (offset,) = parsed(robot, "encoder-offset:right_knee=0.01")
    ended: Any = SimpleNamespace(moved=0.1, at_bound=(), effect_errors=[np.ones(1)])
    start: Any = SimpleNamespace(moved=20.0)
    observed: Any = None
    tried = []

    def rested(self, terms, start, begin=None, afresh=False):
        tried.append(afresh)
        return Judged(terms, ended, 0.0)

    monkeypatch.setattr(CandidateSearch, "tried", rested)
    for ended.at_bound, judged in ((), [False]), (("cell-gain",), [False, True]):
        tried.clear()
        CandidateSearch(observed, None, []).judged_of((), [offset], [offset], start)
        assert tried == judged


def test_the_same_effect_of_other_cells_is_another_candidate(robot, monkeypatch):
    """With wide families the ranking chose wrong ones of a plate, where two of the other were swapped too."""
    pairs = ("front_left,front_right", "rear_right,rear_left")
    front, rear = parsed(robot, *(f"swapped-cells:right={one}" for one in pairs))
    monkeypatch.setattr(CandidateSearch, "fits", lambda self, *_: (front, rear, front))
    monkeypatch.setattr(CandidateSearch, "shortest", lambda self, fit: [fit])
    nothing: Any = None
    assert CandidateSearch(nothing, None, []).best(nothing, ()) == [front, rear]


def test_columns_by_sensitivities_are_those_by_removal(robot, plan, nominal):
    observed = observe(measured(robot, plan.take(plan.placement <= 8), "wii"), nominal)
    search = CandidateSearch.of(observed)
    linear = Data(search.observed, noise_of(search.observed)).null.linear
    laws = {law.target: law for law in law_candidates(linear.observed)}
    for target in (
        "encoder:right_knee/own-angle/sine",
        "encoders:left/own-torque/dead-band",
        "cells:left/plate-load/quadratic-gain",
        "cell:right.rear_left/cop/quadratic",
        "plate:left/time/quadratic",
    ):
        (fast,) = _columns(linear, [laws[target]])
        slow = candidate_columns(linear, [laws[target]])
        noise = np.random.default_rng(0).standard_normal((slow.count, 3))
        for (gram, pull), column in zip(fast.moments(noise)[0], slow.projected[0], strict=True):
            length = np.linalg.norm(column, axis=0)
            assert gram == pytest.approx(column.T @ column, abs=1e-2 * (length**2).max())
            assert pull == pytest.approx(column.T @ noise, abs=3e-2 * length.max())


def test_catalogued_sentences_are_left_to_the_catalogue(robot, plan, nominal):
    observed = observe(measured(robot, plan.take(plan.placement <= 4), "wii"), nominal)
    targets = {law.target for law in law_candidates(observed)}
    assert "encoder:right_knee/own-angle/sine" in targets
    assert "encoder:right_knee/own-angle/linear" not in targets
    assert sentence_of("encoder:right_knee/own-angle/linear").catalogued == "encoder-gain"


def test_joints_that_are_not_logged_have_no_laws(robot, plan, nominal):
    m = measured(robot, plan.take(plan.placement <= 4), "wii")
    held = observe(replace(m, constant_joints={"right_knee": 0.01}), nominal)
    about = [str(sentence_of(law.target)) for law in law_candidates(held)]
    assert not any(part in one for one in about for part in ("encoder:right_knee/", "angle:right_knee/"))
    assert any("encoder:left_knee/" in one for one in about)


def test_a_law_is_seen_although_members_of_families_hold_its_fault(robot, plan, nominal):
    (law,) = parsed(robot, "law:encoder:right_hip_pitch/own-angle/sine=-0.055,-0.049,1,-1.54,0.09")
    rig = injected(preset_rig("force-plate", robot), [law.instance])
    search = CandidateSearch.of(observe(statically(rig, plan.take(plan.placement <= 12)), nominal))
    start = first_calibration(search.observed)
    without, seen = search.glanced((), start), search.glanced((law,), start)
    assert without
    assert seen
    assert seen.evidence > without.evidence + 100


def parsed(robot, *texts):
    """Return what texts say as fitted explanations."""
    out = []
    for text in texts:
        one = EffectInstance.parse(text, robot)
        sizes = np.array([one.values[k] for k in one.effect.sizes])
        out.append(Fitted(Candidate(one.effect, one.target, np.array([one.values])), 0, sizes))
    return out


def test_laws_that_blame_different_things_are_ambiguous(robot):
    zero, bent, pull, plain = parsed(
        robot,
        "law:cells:right/nothing/constant=-1.8",
        "law:cells:right/plate-load/linear=-2,0,250",
        "law:force:torso/nothing/constant=1,2,3",
        "tether=1,2",
    )
    selection: Any = SimpleNamespace(lacks_fit=True)
    each: list[tuple[list[tuple[Fitted, ...]], str]] = [
        ([(zero,), (plain,)], "described"),
        ([(zero, bent)], "described"),  # the same cells err in both
        ([(zero, pull)], "ambiguous"),
        ([(zero,), (plain, pull)], "ambiguous"),
    ]
    for equivalents, verdict in each:
        assert _verdict(selection, (), equivalents, described=True) == verdict


@pytest.mark.parametrize(
    ("reading", "tolerated"),
    [("left_knee", True), ("right_knee", False), ("left.front_left", False), ("", True)],
)
def test_a_pattern_of_another_reading_contradicts_a_law(robot, plan, nominal, reading, tolerated):
    observed = observe(statically(preset_rig("wii", robot), plan.take(plan.placement <= 2)), nominal)
    pattern = Pattern("AC", "something depends on time", 100.0, 2, 1e-9, 1.0, reading)
    assert _inexact(["encoder:left_knee/angle:right_knee/curve"], pattern, observed) == tolerated
    assert not _inexact([], pattern, observed)


@pytest.mark.slow
def test_laws_that_disagree_about_the_base_parameters_are_told_and_not_adopted(robot, plan, monkeypatch):
    def disagreeing(*args):
        chosen = select_laws(*args)
        assert chosen
        return replace(chosen, disagreement=2 * AGREEING)

    monkeypatch.setattr("tulip_testbed.discovery.discover.select_laws", disagreeing)
    rig = injected(preset_rig("force-plate", robot), [EffectInstance.parse(HIDDEN, robot)])
    found = discover(statically(rig, plan), robot, hold_out=False)
    assert (found.verdict, found.adopted, found.corrections) == ("unknown", (), ())
    assert "law:encoder:right_knee/own-angle" in found.reasons[0]


@pytest.mark.slow
def test_an_unusual_member_beside_a_law_is_compared_with_others(robot, plan):
    """Which plate is off its place hardly any experiment shows."""
    texts = (HIDDEN, "plate-translation:right=0.004,-0.003")
    rig = injected(preset_rig("force-plate", robot), [EffectInstance.parse(one, robot) for one in texts])
    found = discover(statically(rig, plan), robot, hold_out=False)
    labels = [{one.label for one in found.equivalents[k]} for k in found.effects]
    assert {"plate-translation:right", "plate-translation:left"} in labels
    assert (found.verdict, found.adopted) == ("ambiguous", ())


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    """An eccentric encoder, hidden, described and taken out; the folder of all of it."""
    folder = tmp_path_factory.mktemp("described")
    what = ["--sensors", "force-plate", "--seed", "3", "--engine", "statics", "--effects", HIDDEN]
    assert main(["simulate", *what, "--out", str(folder / "data"), "--json"]) == 0
    run = ["--no-check", "--out", str(folder / "found"), "--json"]
    assert main(["discover", str(folder / "data"), *run]) == 0
    return folder


@pytest.mark.slow
def test_an_eccentric_encoder_is_described_with_its_size(described):
    report = json.loads((described / "found" / "result.json").read_text())
    assert report["verdict"] == "described"
    (law,) = report["adopted"]
    assert (law["name"], law["target"]) == ("law", "encoder:right_knee/own-angle/sine")
    for number, true in zip(law["parameters"], (0.004, 0.003), strict=False):
        half = (number["high95"] - number["low95"]) / 2
        assert abs(number["value"] - true) < 1.5 * half
        assert half < 0.001
    assert EffectInstance.from_document(law).finding in report["story"][0]


@pytest.mark.slow
def test_the_law_s_curve_has_the_residuals_on_it(described, robot):
    (curve,) = law_curves(Discovered.load(described / "found", robot))
    angle = np.radians(curve.at)
    true = 4.0 * np.sin(angle) + 3.0 * np.cos(angle)
    assert (curve.x_unit, curve.unit) == ("deg", "mrad")
    assert np.sqrt(np.mean(((curve.error - true) / curve.sd) ** 2)) < 2
    assert np.abs(curve.error).mean() > 3 * np.median(np.abs(curve.error - true))
    page = html(discovery_page(Discovered.load(described / "found", robot)))
    assert "law-0" in page


@pytest.mark.slow
def test_a_described_law_takes_the_bias_away(described, robot, plan):
    """Without noise, so that nothing else is left in the estimate."""
    plain = preset_rig("force-plate", robot)
    faulty = injected(plain, [EffectInstance.parse(HIDDEN, robot)])
    data = replace(simulated(without_noise(faulty), plan), sensors=header_of(plain).sensors)
    true, spread = true_base_parameters(plain), None
    bias = []
    for adopted in ((), read_rig(described / "found" / "rig", robot)):
        full = identify(data, robot, estimator=MIXED_MODEL, adopted=adopted).full
        spread = np.sqrt(np.diag(full.covariance)) if spread is None else spread
        bias.append(np.sqrt((((full.value - true) / spread) ** 2).mean()))
    before, after = bias
    assert after < 0.3 * before

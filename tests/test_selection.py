"""The choice among candidates by their evidence, in searches whose evidence is known."""

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.stats import cauchy, chi2, norm

from tulip_testbed.discovery import candidate_search
from tulip_testbed.discovery.candidate_search import CandidateSearch, Judged
from tulip_testbed.discovery.candidates import Candidate, Fitted
from tulip_testbed.discovery.selection import (
    Chosen,
    _begun_otherwise,
    _chance,
    _without_idle,
    best_by_itself,
    judged_again,
)
from tulip_testbed.discovery.unusual_members import WIDEST, _in_its_place, with_unusual_members
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import EffectInstance


def explains(label, log, target="one"):
    candidate: Any = SimpleNamespace(label=label, target=target)
    return Fitted(candidate, 0, np.zeros(1), log)


@dataclasses.dataclass
class Evidences:
    """A search that knows ln of the evidence for single terms and for pairs."""

    known: dict[str, float]
    found: list[Any] = dataclasses.field(default_factory=list)
    widest: float = np.inf
    single: tuple[Any, ...] = ()

    def tried(self, terms, start):
        evidence = self.known["".join(term.label for term in terms)]
        return SimpleNamespace(evidence=evidence, possible=True, steady=True)

    def best(self, _, __):
        return []

    def judged_of(self, *_):
        return [one for one in self.single if self.widest == WIDEST]

    def pairs(self, _, __, kinds, ___):
        return [one for one in self.found if one.kind in kinds and self.widest == WIDEST]


def test_alternatives_are_compared_with_families_of_their_own():
    tare, gain, lag, creep = map(explains, ("tare", "gain", "lag", "creep"), (24.0, 27.0, 20.0, 15.0))
    search: Any = Evidences({"tare": 5.0, "gain": 3.5, "lag": 0.0})
    fit: Any = SimpleNamespace(terms=(tare,))
    found = judged_again(search, cast(Any, None), fit, 0, (gain, tare, lag, creep))
    assert [(one.label, one.log_bayes_factor) for one in found] == [
        ("tare", 24.0),
        ("gain", 22.5),
        ("lag", 19.0),
        ("creep", 15.0),
    ]


class Restless(Evidences):
    """A search that knows the evidence about two calibrations; about the first nothing comes to rest."""

    budget = SimpleNamespace(spent=False)
    without_idle = CandidateSearch.without_idle

    def tried(self, terms, start):
        evidence = self.known[start + ":" + "+".join(term.label for term in terms)]
        return SimpleNamespace(terms=terms, evidence=evidence, steady=start == "there")

    def calibrated(self, _):
        return "there"


def test_a_term_that_the_newest_makes_idle_goes_once_both_came_to_rest():
    """The spring gains 27 beside a sole that has not come to rest, and 1 where it has."""
    spring, sole = explains("spring", 11.0), explains("sole", 27.0)
    known = {"here:spring+sole": 38.0, "here:sole": 11.0, "there:spring+sole": 9.0, "there:sole": 8.0}
    search: Any = Restless(known)
    best = _without_idle(search, search.tried((spring, sole), "here"), cast(Any, "here"))
    assert [term.label for term in best.terms] == ["sole"]


def test_the_only_member_of_a_family_is_not_judged_against_itself():
    """With the payload the drift of all gains stays in its family, and explains the readings from there."""
    drift, payload = explains("drift", 8.7, target=""), explains("payload", 8.6)
    search: Any = Evidences({"drift": 0.0, "payload": 2.7})
    fit: Any = SimpleNamespace(terms=(drift,))
    assert judged_again(search, cast(Any, None), fit, 0, (drift, payload)) == (drift, payload)


def with_families(**spreads):
    families = [SimpleNamespace(family=SimpleNamespace(name=name, targets=(1, 2))) for name in spreads]
    for one, spread in zip(families, spreads.values(), strict=True):
        one.spread, one.spread95 = spread, (spread / 2, spread * 2)
    smooth = SimpleNamespace(tree=SimpleNamespace(joints=()))
    return SimpleNamespace(families=families, linear=SimpleNamespace(smooth=smooth))


@pytest.mark.parametrize(
    ("kind", "gain", "spreads", "count"),
    [
        ("gain", 6.5, (1.0, 1.0), 1),
        ("gain", 5.5, (1.0, 1.0), 0),
        ("gain", 6.5, (5.0, 1.0), 0),
        ("tare", 6.5, (1.0, 1.0), 1),  # two tares look like gains of all cells
        ("tare", 6.5, (1.0, 5.0), 0),
    ],
)
def test_a_pair_of_members_is_decisive_and_leaves_families_as_usual(kind, gain, spreads, count):
    left = with_families(gain=spreads[0], tare=spreads[1])
    pair = SimpleNamespace(kind=kind, evidence=gain, calibration=left, steady=True)
    search: Any = Evidences({"": 0.0}, [pair])
    assert len(_in_its_place(search, cast(Any, with_families(gain=6.0, tare=1.0)), ())) == count


@pytest.mark.parametrize(
    ("gain", "spread", "name"), [(6.5, 1.0, "hoist"), (5.5, 1.0, "tare"), (6.5, 5.0, "tare")]
)
def test_another_effect_comes_before_pairs_in_the_place_of_a_wide_family(gain, spread, name):
    """A hoist looks like tares of all cells."""
    pair = SimpleNamespace(kind="tare", evidence=9.0, calibration=with_families(tare=1.0), steady=True)
    hoist = SimpleNamespace(kind="hoist", evidence=gain, calibration=with_families(tare=spread), steady=True)
    search: Any = Evidences({"": 0.0}, [pair], single=(hoist,))
    found: list[Any] = list(_in_its_place(search, cast(Any, with_families(tare=6.0)), ()))
    assert [one.kind for one in found] == [name]


def test_what_is_undone_exactly_is_judged_however_many_explain_a_gross_gap(monkeypatch):
    """Of cells exchanged at `wii`, three faults of a knee explained more of what had to be exact."""
    near = [explains(f"knee-{k}", 1500.0) for k in range(3)]
    gain, logged, swapped = map(explains, ("gain", "logged", "swapped"), (900.0, 700.0, 600.0))
    play, foot = explains("play", 1800.0), explains("foot", 9.0)
    for one in (*near, gain, logged, swapped, play, foot):
        cast(Any, one.candidate).effect = SimpleNamespace(name=one.label, exchanges=one is swapped)
    monkeypatch.setattr(candidate_search, "shortlist", lambda adopted, order: near)
    monkeypatch.setattr(candidate_search, "fit_in_addition", lambda adopted, one: one)
    search = CandidateSearch(cast(Any, []), None, [])
    monkeypatch.setattr(CandidateSearch, "ranked", lambda self, adopted: [*near, gain, logged, swapped])
    adopted: Any = SimpleNamespace(
        ranked={}, terms=(), labels=[], linear=SimpleNamespace(smoothed=None), partialled_out=None
    )
    assert search.shortest(adopted) == [*near, swapped]
    monkeypatch.setattr(candidate_search, "loosest", lambda linear, others: [play, foot])
    adopted.ranked.clear()
    assert search.shortest(adopted) == [*near, play, swapped]


@pytest.mark.parametrize(("gain", "added"), [(3.5, True), (2.5, False)])
def test_a_decisive_member_is_added_whatever_family_is_too_wide_then(monkeypatch, gain, added):
    """A gain took up the cross-talk that its family had hidden."""
    member: Any = explains("cell-gain", 0.0)
    member.candidate.effect = SimpleNamespace(name="gain", sizes=(), misreads=True)
    before, after = with_families(gain=6.0, crosstalk=1.0), with_families(gain=1.0, crosstalk=6.0)
    wide = {id(before): [member], id(after): []}
    module = "tulip_testbed.discovery.unusual_members"
    monkeypatch.setattr(f"{module}._unusual_members", lambda *_: [])
    monkeypatch.setattr(f"{module}._of_wide_families", lambda _, calibration: wide[id(calibration)])
    monkeypatch.setattr(f"{module}._in_its_place", lambda *_: [])
    monkeypatch.setattr(f"{module}.at_estimate", lambda terms, _: terms)
    search: Any = SimpleNamespace(
        budget=SimpleNamespace(spent=False),
        calibrated=lambda one: one.calibration,
        tried=lambda terms, _: SimpleNamespace(
            terms=terms, evidence=gain * len(terms), possible=True, steady=True, calibration=after
        ),
    )
    assert with_unusual_members(search, cast(Any, before), ())[1] == ((member,) if added else ())


def test_what_gains_only_by_noise_of_another_calibration_is_not_the_best():
    """In its own noise the softer joint explains nothing; what is far behind is not asked."""
    at_start = {"joint-compliance": 5475.7, "backlash": 5471.5, "encoder-load": 5450.0}
    by_itself = {"joint-compliance": 5335.8, "backlash": 5477.5}
    several: Any = [SimpleNamespace(terms=k, evidence=e, steady=True) for k, e in at_start.items()]
    search: Any = SimpleNamespace(
        calibrated=lambda one: one, evidence=lambda one, terms, start: by_itself[terms]
    )
    assert best_by_itself(search, several, several[0]).terms == "backlash"
    assert best_by_itself(search, [several[0], several[2]], several[0]).terms == "joint-compliance"


@pytest.mark.parametrize(("plays", "kept"), [(4304.0, "plays"), (4250.0, "commands")])
def test_where_the_effects_do_not_suffice_the_first_is_left_out(monkeypatch, plays, kept):
    """Five effects that began with a logged command do worse than two plays."""
    command, play, more = (explains(label, 0.0) for label in ("command", "play", "more"))
    found: dict[str, Any] = {"commands": (command, more), "plays": (play,)}
    evidence = {"commands": 4255.0, "plays": plays}

    def forward(search, null, begun, terms, *_):
        if terms:  # nothing is decisive in addition
            return Chosen(begun, terms, complete=True)
        every = {one.label for one in search.candidates}
        way = "commands" if "command" in every else "plays"
        return Chosen(cast(Any, way), found[way], complete=way == "plays")

    @dataclasses.dataclass
    class Choice:
        candidates: list[Any]

        def tried(self, terms, _):
            way = next(name for name, several in found.items() if several == terms)
            return SimpleNamespace(evidence=evidence[way], possible=True, steady=True)

    monkeypatch.setattr("tulip_testbed.discovery.selection._forward", forward)
    search: Any = Choice([one.candidate for one in (command, play, more)])
    begun, selection = cast(Any, None), SimpleNamespace(null=None, tests=1.0)
    first = Chosen(cast(Any, "commands"), found["commands"], complete=False)
    again = _begun_otherwise(search, cast(Any, selection), begun, (), first, lambda _: None)
    assert again.calibration == kept


@pytest.mark.parametrize(("at_a_glance", "count"), [(15.0, 2), (7.0, 1)])
def test_what_promises_more_without_the_members_is_judged_so_too(monkeypatch, at_a_glance, count):
    """A hoist of 4 N with the members, of 21 N without: both come to rest."""
    hoist = explains("hoist", 20.0)
    cast(Any, hoist.candidate).settings = np.zeros((1, 1))
    alone = dataclasses.replace(hoist, sizes=np.ones(1))
    evidence = {0: 3.0, 1: at_a_glance}
    rests = SimpleNamespace(at_bound=(), moved=0.0)

    def glanced(_, terms, start):
        return SimpleNamespace(
            evidence=evidence[int(terms[-1].sizes[0])] if terms else 0.0, calibration=rests
        )

    def tried(_, terms, start, begin, afresh):
        return SimpleNamespace(evidence=5.0, possible=True, steady=True, calibration=rests, afresh=afresh)

    monkeypatch.setattr(CandidateSearch, "glanced", glanced)
    monkeypatch.setattr(CandidateSearch, "tried", tried)
    search = CandidateSearch(cast(Any, []), None, [])
    judged: list[Any] = search.judged_of((), [hoist], [alone], cast(Any, rests))
    assert [one.afresh for one in judged] == [False, True][:count]


@pytest.mark.parametrize(
    ("sizes", "possible"),
    [((3e-4, 1e-4), True), ((3e-4, -1e-5), True), ((3e-4, -2e-4), False), ((-1e-5, -1e-5), False)],
)
def test_noise_alone_makes_no_size_impossible_beside_another(sizes, possible):
    floor = Candidate(catalogue()["floor-compliance"], "", np.zeros((1, 2)))
    calibration: Any = SimpleNamespace(effect_errors=[np.array([8e-5, 8e-5])])
    assert Judged((Fitted(floor, 0, np.array(sizes)),), calibration, 0.0).possible == possible


@pytest.mark.parametrize("times", [0.5, 1.0, 3.0])
def test_a_size_larger_than_plausible_is_no_likelier_by_chance(times):
    """Of one number with a Cauchy prior: the evidence is integrated, the chance is its likelihood ratio's."""
    effect, scale = catalogue()["tether-spring"], 20.0
    size, error = times * scale, times * scale / 4
    ratio = float(norm.logpdf(size, size, error) - norm.logpdf(size, 0.0, error))
    sizes = np.linspace(size - 9 * error, size + 9 * error, 2001)
    weight = norm.pdf(size, sizes, error) * cauchy.pdf(sizes, scale=scale)
    gain = float(np.log(np.trapezoid(weight, sizes) / norm.pdf(size, 0.0, error)))
    mean = np.average(sizes, weights=weight)
    sd = np.sqrt(np.average((sizes - mean) ** 2, weights=weight))
    found: Any = SimpleNamespace(
        effects=[EffectInstance(effect, "", (float(mean),))], effect_errors=[np.array([sd])]
    )
    assert np.log(_chance(found, gain, 1.0, 1)) == pytest.approx(np.log(chi2.sf(2 * ratio, 1)), abs=0.25)

"""The outcome of one case: the hidden effects and the effects that were found."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Found:
    """One term of a discovery.

    Attributes:
        label: as on the command line. values: of its parameters [SI].
        low, high: 95 % interval of each, None where there is none.
        alike: labels of all explanations of its gap, the best first.
    """

    label: str
    values: tuple[float, ...]
    low: tuple[float | None, ...]
    high: tuple[float | None, ...]
    alike: tuple[str, ...]


@dataclass(frozen=True)
class Bias:
    """Of the base parameters, in their standard errors, noise taken out.

    Attributes:
        largest: of all parameters, before. before, after: r.m.s. over them.
    """

    largest: float
    before: float
    after: float


@dataclass(frozen=True)
class Outcome:
    """One case.

    Attributes:
        arm, kinds, multiple, dynamics: see `cases.Case`.
        hidden: labels. values: of their parameters [SI].
        predicted: power of the detection by theory; 0 where there is none.
        twins: for every hidden effect labels of what can look like it.
        remainder: of one hidden fault, what the closest other candidate leaves of its signal, as a multiple
            of what is found.
        failed: why there was no data set, or "".
        rows: measured.
        verdict: of the discovery, or "refused". found: its effects.
        calibrated: its ordinary imperfections, that with the most standard errors first.
        unseen: labels of what it says it cannot see, where hidden; biased: the base parameter named.
        held: whitened r.m.s. on held-out placements before, after, and its floor; None: not asked.
        coverage, times: whether the 95 % interval of every size, of every time holds the truth, where the
            true effect was said.
        bias: None: not asked.
        wall_s, cpu_s: of the discovery [s].
        imperfect: see `cases.Case`. members, base: whether the 95 % interval of every ordinary imperfection
            that was adopted, of every base parameter holds the truth, in an ordinary world.
    """

    run: int
    arm: str
    kinds: tuple[str, ...]
    multiple: float
    dynamics: bool
    hidden: tuple[str, ...] = ()
    values: tuple[tuple[float, ...], ...] = ()
    predicted: float = 0.0
    twins: tuple[tuple[str, ...], ...] = ()
    remainder: float = 0.0
    failed: str = ""
    rows: int = 0
    verdict: str = ""
    found: tuple[Found, ...] = ()
    calibrated: tuple[Found, ...] = ()
    unseen: bool = False
    biased: int = 0
    held: tuple[float, float, float] | None = None
    coverage: tuple[bool, ...] = ()
    times: tuple[bool, ...] = ()
    bias: Bias | None = None
    wall_s: float = 0.0
    cpu_s: float = 0.0
    imperfect: bool = False
    members: tuple[bool, ...] = ()
    base: tuple[bool, ...] = ()

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    @property
    def isolable(self) -> bool:
        """Whether nothing else in the catalogue can look like what is hidden."""
        return not any(self.twins)

    @property
    def names(self) -> list[str]:
        """Of what was found first for every gap."""
        return [term.label for term in self.found]

    @property
    def said(self) -> bool:
        """Whether a name was given."""
        return self.verdict in ("named", "ambiguous")

    @property
    def flagged(self) -> bool:
        """Whether a gap was observed."""
        return self.verdict != "none"


def outcome(document: dict[str, Any]) -> Outcome:
    """From JSON."""
    listed = {"kinds", "hidden", "coverage", "times", "members", "base"}
    nested = {"values", "twins"}
    values: dict[str, Any] = {k: tuple(v) if k in listed else v for k, v in document.items()}
    values |= {k: tuple(tuple(x) for x in document[k]) for k in nested}
    for key in ("found", "calibrated"):
        values[key] = tuple(
            Found(t["label"], *(tuple(t[part]) for part in ("values", "low", "high", "alike")))
            for t in document.get(key, ())
        )
    values["held"] = None if document["held"] is None else tuple(document["held"])
    values["bias"] = None if document["bias"] is None else Bias(**document["bias"])
    return Outcome(**values)

"""Which members of a family become effects of their own, with stated evidence in place of an estimate."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tulip_testbed.discovery import unusual_members
from tulip_testbed.discovery.unusual_members import with_unusual_members

CELLS = tuple(f"cell {k}" for k in range(8))
EFFECT = SimpleNamespace(name="cell-gain")


def calibrated(values, spread):
    """A family with tolerance 1 whose members are known to 0.5."""
    family = SimpleNamespace(name="cell-gain", targets=CELLS, sizes=np.ones(8), effect=EFFECT)
    one = SimpleNamespace(
        family=family, spread=spread, spread95=(0.5 * spread, 2 * spread), value=np.array(values)
    )
    one.standard_error, one.determined = np.full(8, 0.5), np.ones(8, bool)
    return SimpleNamespace(families=[one])


class Search:
    """Evidence -4 for the member that is off, in whose company the family is usual or not; +1 for others."""

    def __init__(self, usual: bool):
        self.usual, self.budget = usual, SimpleNamespace(spent=False)
        self.candidates = [SimpleNamespace(label=f"cell-gain:{cell}", effect=EFFECT) for cell in CELLS]

    def tried(self, terms, calibration):
        off = any(term.label == "cell-gain:cell 0" for term in terms)
        after = calibrated(np.zeros(8), 0.6) if off and self.usual else calibration
        evidence = 0.0 if not terms else -4.0 if off else 1.0
        return SimpleNamespace(terms=terms, calibration=after, evidence=evidence, possible=True, steady=True)

    def calibrated(self, judged):
        return judged.calibration


@pytest.mark.parametrize(("usual", "named"), [(True, ["cell-gain:cell 0"]), (False, [])])
def test_a_member_that_makes_its_family_too_wide_is_named_and_no_other_is(usual, named, monkeypatch):
    monkeypatch.setattr(unusual_members, "at_estimate", lambda terms, calibration: terms)
    search: Any = Search(usual)
    first: Any = calibrated([16.0, 0.5, -2.0, -0.8, 1.8, -0.6, -0.9, -0.4], 5.6)
    _, terms = with_unusual_members(search, first, ())
    assert [term.label for term in terms] == named

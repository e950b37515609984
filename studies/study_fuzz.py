"""Do broken folders and robots end in a right result or in one message? Markdown tables.

1,000 mutated measurement and plan folders, 200 mutated robots; docs/reliability.md holds the result.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from studies.runner import header, row
from tests.fuzz.cases import MEASUREMENTS_ONLY, MUTATIONS
from tests.fuzz.robot_cases import ROBOT_MUTATIONS
from tests.fuzz.runner import Bases, Case, Outcome, run_cases
from tulip_testbed.cli.main import main as tulip
from tulip_testbed.sim.shipped import ASSETS


def make_bases(place: Path) -> Bases:
    """A small experiment, its plan, the shipped robot, and two postures to hold."""
    plan, small, data = place / "plan", place / "small", place / "data"
    for out, placements, per in ((plan, 6, 5), (small, 4, 4)):
        shape = ["--placements", str(placements), "--per-placement", str(per), "--seed", "107"]
        assert tulip(["postures", "--random", "--out", str(out), *shape, "--json"]) == 0
    assert tulip(["simulate", str(plan), "--out", str(data), "--seed", "107", "--json"]) == 0
    return Bases(data, plan, ASSETS / "tulip_mjcf", small)


def cases_of(folders: int, robots: int, seed: int) -> list[Case]:
    """Every mutation about equally often."""
    both = [("measurements", name) for name in MUTATIONS]
    both += [("plan", name) for name in MUTATIONS if name not in MEASUREMENTS_ONLY]
    made = [Case(*both[k % len(both)], seed + k) for k in range(folders)]
    names = list(ROBOT_MUTATIONS)
    return made + [Case("robot", names[k % len(names)], seed + k) for k in range(robots)]


def table(outcomes: list[Outcome]) -> str:
    """Outcomes by target and mutation."""
    tally = Counter((o.case.target, o.case.mutation, "FAILED" if o.failed else o.result) for o in outcomes)
    lines = [header("input", "mutation", "cases", "accepted, right", "refused", "FAILED")]
    for target, name in dict.fromkeys((o.case.target, o.case.mutation) for o in outcomes):
        counts = [tally[target, name, kind] for kind in ("accepted", "refused", "FAILED")]
        lines.append(row(target, name.replace("_", " "), sum(counts), *counts))
    totals = [
        sum(count for key, count in tally.items() if key[2] == kind)
        for kind in ("accepted", "refused", "FAILED")
    ]
    lines.append(row("all", "", sum(totals), *totals))
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folders", type=int, default=1_000)
    parser.add_argument("--robots", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", help="mutations whose name holds this")
    parser.add_argument("--verbose", action="store_true", help="every refusal's message")
    arguments = parser.parse_args()
    began, outcomes = time.monotonic(), []
    with tempfile.TemporaryDirectory() as place:
        sys.stdout = sys.stderr
        bases = make_bases(Path(place))
        sys.stdout = sys.__stdout__
        cases = cases_of(arguments.folders, arguments.robots, arguments.seed)
        cases = [case for case in cases if arguments.only is None or arguments.only in case.mutation]
        for outcome in run_cases(cases, bases, arguments.workers):
            outcomes.append(outcome)
            if outcome.failed or arguments.verbose:
                print(
                    f"{outcome.case}: {outcome.result}: {outcome.detail.strip()[-1500:]}",
                    file=sys.stderr,
                    flush=True,
                )
    outcomes.sort(key=lambda o: cases.index(o.case))
    print(table(outcomes))
    slowest = max(outcomes, key=lambda o: o.seconds)
    print(
        f"\nSlowest: {slowest.case.mutation}, {slowest.seconds:.0f} s; all {time.monotonic() - began:.0f} s."
    )
    return int(any(outcome.failed for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())

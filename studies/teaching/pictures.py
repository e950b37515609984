"""The teaching pictures by name, each with what draws it and how long that takes."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

from studies.teaching.ankle_roll import ankle_roll
from studies.teaching.cloud import SHOWN, cloud
from studies.teaching.ensemble import Ensemble, ensembles
from studies.teaching.signature_pictures import catalogue_pictures, three_faults
from studies.teaching.stepping import film
from studies.teaching.style import DOCS

RUNS = 200


@cache
def _found() -> dict[int, Ensemble]:
    return ensembles(RUNS, tuple(SHOWN))


PICTURES: dict[str, Callable[[Path], Iterable[Path]]] = {
    "plan": lambda folder: [film(folder / "plan.webp")],
    "signatures": lambda folder: [three_faults(folder / "signatures.png")],
    "catalogue": lambda folder: catalogue_pictures(folder / "signatures"),
    "cloud": lambda folder: [cloud(_found(), folder / "cloud.png")],
    "ankle-roll": lambda folder: [ankle_roll(_found()[max(SHOWN)], folder / "ankle-roll.png")],
}


def main(names: list[str]) -> int:
    """Draw the named pictures, or all; return the exit code."""
    if unknown := [name for name in names if name not in PICTURES]:
        print(f"pictures: found {', '.join(unknown)}; expected {', '.join(PICTURES)}", file=sys.stderr)
        return 2
    DOCS.mkdir(exist_ok=True)
    for name in names or PICTURES:
        began = time.perf_counter()
        for path in PICTURES[name](DOCS):
            print(f"{path.relative_to(DOCS.parents[1])}: {path.stat().st_size / 1e3:.0f} kB")
        print(f"{name}: {time.perf_counter() - began:.0f} s")
    return 0

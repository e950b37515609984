"""The whole story: a hidden effect, identification gone wrong, discovery, identification set right.

Everything is done by `tulip`'s own commands, in the full dynamics; the truth is read here alone.
"""

from __future__ import annotations

import io
import json
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.cli.main import main as tulip

SIZE = 0.01  # rad
EFFECT = f"encoder-offset:right_ankle_roll={SIZE}"
SETTING = ("--preset", "force-plate", "--seed", "3")
ODD = 3.0  # standard errors that one parameter in 370 exceeds by chance


def main(folder: Path) -> int:
    """Tell it; 0 if the effect was named and the parameters are right in the end."""
    began = time.perf_counter()
    folder.mkdir(parents=True)
    data, truth, found = folder / "data", folder / "truth.json", folder / "found"
    _say(
        "1. An encoder sits half a degree wrong (0.573 deg), and nobody notices. 150 postures on two plates."
    )
    _run("simulate", "--out", data, "--truth", truth, *SETTING, "--effect", EFFECT)
    _say("2. The robot is identified from what was measured. Its parameters have small standard errors ...")
    wrong = _errors(_run("identify", data, "--json"), truth)
    _say(f"   ... and are wrong: {_judged(wrong)}.")
    _say("3. What does the model lack?")
    document = _run("discover", data, "--out", found, "--json")
    _say(f"   Verdict: {document['verdict']}.")
    for line in document["story"]:
        _say(f"   {line}")
    _say("4. The effect is adopted: identified again with it.")
    if not document["effects"]:
        return 1
    right = _errors(_run("identify", data, "--rig", found / "rig", "--json"), truth)
    _say(f"   Now {_judged(right)}.")
    value = document["effects"][0]["parameters"][0]
    _say(f"   Hidden {SIZE} rad; found {value['value']:.5f} [{value['low95']:.5f}, {value['high95']:.5f}].")
    _say("5. For a colleague:")
    _run("report", found, "--out", folder / "found.html")
    _run("view", found, "--save", folder / "found.rrd")
    _say(f"   {folder}/found.html opens in any browser, `rerun {folder}/found.rrd` shows the postures.")
    _say(f"It took {time.perf_counter() - began:.0f} s.")
    return int(document["verdict"] != "named" or np.abs(right).max() > ODD)


def _errors(document: dict[str, Any], truth: Path) -> np.ndarray:
    """Estimate minus truth in stated standard errors, (p,)."""
    true = json.loads(truth.read_text(encoding="utf-8"))["base_parameters"]
    rows = document["full"]["parameters"]
    return np.array([(row["estimate"] - true[row["name"]]) / row["standard_error"] for row in rows])


def _judged(errors: np.ndarray) -> str:
    size = np.abs(errors)
    return (
        f"{int((size > ODD).sum())} of {len(size)} parameters are off by more than {ODD:g} standard errors, "
        f"the worst by {size.max():.1f}; r.m.s. {np.sqrt(np.mean(size**2)):.2f}"
    )


def _run(*arguments: object) -> dict[str, Any]:
    """A command of `tulip`, told, its chatter kept back unless it fails; what it prints as JSON."""
    _say(f"$ tulip {' '.join(map(str, arguments))}")
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = tulip([str(argument) for argument in arguments])
    if code != 0:
        sys.exit(f"{err.getvalue()}\ntulip {arguments[0]} ended with {code}")
    return json.loads(out.getvalue()) if "--json" in arguments else {}


def _say(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    sys.exit(main(Path("runs") / f"demo-{datetime.now():%Y%m%d-%H%M%S}"))

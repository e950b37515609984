"""The whole story: an ordinary laboratory in which one thing is badly wrong.

Identified wrong; the cause found among a hundred small imperfections; identified right. Everything is done by
`tulip`'s own commands, in the full dynamics; the truth is read here alone.
"""

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

SIZE = 0.02  # rad
EFFECT = f"encoder-offset:right_ankle_roll={SIZE}"
SETTING = ("--sensors", "force-plate", "--seed", "3", "--robot-spread", "0.1", "--imperfections", "1")
NAIVE = ("--estimator", "mixed-model")
ODD = 3.0  # standard errors that one parameter in 370 exceeds by chance


def main(folder: Path) -> int:
    """Tell it; 0 if the effect was named and the parameters are right in the end."""
    began = time.perf_counter()
    folder.mkdir(parents=True)
    data, truth, found = folder / "data", folder / "truth.json", folder / "found"
    _say("1. Every encoder, cell, link and plate is a little off, as everywhere. One encoder is off by")
    _say("   1.15 deg, and nobody notices. Masses differ from CAD by some 10 %. 150 postures on two plates.")
    _run("simulate", "--out", data, "--truth", truth, *SETTING, "--effects", EFFECT)
    _say("2. The robot is identified as if the laboratory were exact. Its standard errors are small ...")
    wrong = _errors(_run("identify", data, *NAIVE, "--json"), truth)
    _say(f"   ... and its parameters are wrong: {_judged(wrong)}.")
    before = _run("identify", data, "--json")
    _say(f"   With ordinary imperfections as unknowns: {_judged(_errors(before, truth))}.")
    _say("3. What does the model lack?")
    document = _run("discover", data, "--out", found, "--json")
    _say(f"   Verdict: {document['verdict']}.")
    for line in document["story"]:
        _say(f"   {line}")
    _say("4. What was found is added to the model, and the robot is identified again.")
    if not document["adopted"]:
        return 1
    after = _run("identify", data, "--corrections", found / "rig", "--json")
    right = _errors(after, truth)
    _say(f"   Now {_judged(right)}.")
    value = document["adopted"][0]["parameters"][0]
    _say(f"   Hidden {SIZE} rad on top of that encoder's own error, {_hidden(truth):.5f} rad in all; ")
    _say(f"   found {value['value']:.5f} [{value['low95']:.5f}, {value['high95']:.5f}].")
    _say("5. Does the exported model predict new postures better than CAD? The encoder is repaired.")
    model, new = folder / "identified.xml", folder / "new"
    _run("export", found, "--out", model)
    _run(
        *["plan", "random", "--placements", "12", "--per-placement", "5", "--seed", "8", "--out"],
        folder / "plan",
    )
    _run("simulate", folder / "plan", "--out", new, *SETTING, "--engine", "statics")
    scores = _run("predict", new, "--exported", model, "--json")["models"]
    for name in ("CAD", "exported"):
        missed = next(one["rms_mm"] for one in scores if one["name"] == name)
        _say(f"   {name} misses the centre of pressure by {missed['x']:.1f} and {missed['y']:.1f} mm (x, y).")
    _say("6. For a colleague:")
    _run("report", found, "--out", folder / "found.html")
    _run("view", found, "--save", folder / "found.rrd")
    _say(f"   {folder}/found.html opens in any browser, `rerun {folder}/found.rrd` shows the postures.")
    _say(f"It took {time.perf_counter() - began:.0f} s.")
    return int(document["verdict"] != "named" or np.abs(right).max() > ODD)


def _hidden(truth: Path) -> float:
    """Return the sum of all errors of the encoder's zero [rad]."""
    effects = json.loads(truth.read_text(encoding="utf-8"))["effects"]
    name, target = EFFECT.partition("=")[0].split(":")
    return sum(
        one["parameters"][0]["value"] for one in effects if (one["name"], one["target"]) == (name, target)
    )


def _errors(document: dict[str, Any], truth: Path) -> np.ndarray:
    """Estimate minus truth in stated standard errors, (p,)."""
    true = json.loads(truth.read_text(encoding="utf-8"))["base_parameters"]
    full = document["full"]
    error = np.array(full["value"]) - [true[name] for name in full["names"]]
    return error / np.array(full["standard_error"])


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

"""Kill a hundred `tulip` processes, most while they write, and disturb others (docs/studies/reliability.md; 15 min).

Most kills aim at the moment of writing: the study watches for the first hidden file or folder in which the
result is prepared, and kills a random part of the time later that an undisturbed run needs from there to the
final name. KILL and TERM go to the command alone, as from `kill`, INT and HUP to its whole group, as from a
terminal. A result has to be that of an undisturbed run, byte for byte where two of these agree, or absent.
"""

from __future__ import annotations

import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from studies.kills.attempt import PATIENCE, SIGNALS, attempt, start
from studies.kills.commands import COMMANDS, TULIP, Command, prepare
from studies.kills.obstacles import file_size_limit, full_disk, pairs, read_only_folder, two_writers
from studies.kills.results import Reference, again, clear, left, reference
from studies.runner import Settings, header, row

SETTINGS = Settings(seed=1_000, only=("kills", "obstacles"))
OUTCOMES = ("before writing", "while writing", "whole", "BROKEN")
SERVE = Command("view --serve", [*TULIP, "view", "../run", "--serve"], ())
AIMED = 0.6  # of the kills
Places = dict[str, tuple[Command, Path, Reference]]


def study(settings: Settings) -> Iterator[str]:
    """Yield the tables of what was left."""
    with tempfile.TemporaryDirectory() as temporary:
        home, places = Path(temporary), {}
        prepare(home)
        for number, command in enumerate([*COMMANDS, SERVE]):
            place = home / str(number)
            place.mkdir()
            wanted = reference(command, place) if command.results else Reference({}, (), 0.0, 0.0)
            places[command.name] = command, place, wanted
        if "kills" in settings.only:
            yield from kills(settings, places)
        if "obstacles" in settings.only:
            yield from obstacles(places)


def kills(settings: Settings, places: Places) -> Iterator[str]:
    """Kill the commands in turn, by each signal in turn."""
    chance, names = random.Random(settings.seed), list(places)
    tally, signals, slowest = Counter(), Counter(), dict.fromkeys(SIGNALS, 0.0)
    for k in range(settings.count(100)):
        name, number = names[k % len(names)], SIGNALS[k // len(names) % len(SIGNALS)]
        outcome, gone = killed(*places[name], number, chance)
        tally[name, outcome] += 1
        tally[number, outcome] += 1
        signals[name, number] += 1
        slowest[number] = max(slowest[number], gone)
    yield header("command", "run, writing (s)", "signals", *OUTCOMES)
    for name, (command, _, wanted) in places.items():
        times = f"{wanted.total:.1f}, {wanted.writing:.3f}" if command.results else "until it is ended"
        sent = ", ".join(f"{short(number)} {signals[name, number]}" for number in SIGNALS)
        yield row(name, times, sent, *(tally[name, outcome] for outcome in OUTCOMES))
    yield "\n" + header("signal", *OUTCOMES, "last process gone after at most (s)")
    for number in SIGNALS:
        counts = (tally[number, outcome] for outcome in OUTCOMES)
        yield row(short(number), *counts, f"{slowest[number]:.1f}")
    faults = [complain(name, again(*places[name])) for name in names if places[name][0].results]
    yield f"\nAfter one more run of each command, undisturbed, {sum(faults)} of them had left something."


def killed(
    command: Command, place: Path, wanted: Reference, number: signal.Signals, chance: random.Random
) -> tuple[str, float]:
    """Kill one command; which of `OUTCOMES` it left, and after how many seconds its last process was gone."""
    if not command.results:
        return killed_server(command, place, number, chance)
    clear(command, place)
    aimed = chance.random() < AIMED
    after = chance.uniform(0.0, 1.1 * wanted.writing if aimed else wanted.total)
    end = attempt(command, place, number, after, aimed)
    what = left(command, place, wanted)
    fault = "" if what in ("nothing", "begun", "whole") else what
    if end.gone > PATIENCE:
        fault = "a process is left"
    elif "Traceback" in end.said and command.line[: len(TULIP)] == TULIP:
        fault = end.said
    elif command.resumes and what in ("nothing", "begun"):
        fault = again(command, place, wanted, resume=True)
    if complain(f"{command.name}, {short(number)}", fault):
        return "BROKEN", end.gone
    return "whole" if what == "whole" else OUTCOMES[end.wrote], end.gone


def killed_server(
    command: Command, place: Path, number: signal.Signals, chance: random.Random
) -> tuple[str, float]:
    """Kill a command that shows its view until it is ended."""
    started = start(command, place)
    while "Open http" not in started.said():
        assert started.process.poll() is None, started.said()
        time.sleep(0.05)
    time.sleep(chance.uniform(0.0, 3.0))
    started.disturb(number)
    gone = started.gone_after()
    fault = "a process is left" if gone > PATIENCE else ""
    return OUTCOMES[3 if complain(f"{command.name}, {short(number)}", fault) else 0], gone


def obstacles(places: Places) -> Iterator[str]:
    """Let commands write at the same time, and where they cannot."""
    yield "\n" + header("disturbance", "cases", "as it has to be", "FAILED")
    faults = []
    for first, second in pairs():
        _, place, wanted = places[first.name]
        other = wanted if second == first else reference(second, place)
        what = f"two writers, {first.name}, {', '.join(second.results)}"
        faults.append(complain(what, two_writers((first, second), place, (wanted, other))))
        clear(second, place)
    yield row("two writers at once", len(faults), faults.count(False), faults.count(True))
    for obstacle in (file_size_limit, full_disk, read_only_folder):
        what = obstacle.__name__.replace("_", " ")
        faults = [
            complain(f"{what}, {command.name}", obstacle(command, place, wanted))
            for command, place, wanted in places.values()
            if command.results
        ]
        yield row(what, len(faults), faults.count(False), faults.count(True))


def complain(what: str, fault: str) -> bool:
    """Print a fault, if it is one."""
    if fault:
        print(f"{what}: {fault}", file=sys.stderr, flush=True)
    return bool(fault)


def short(number: signal.Signals) -> str:
    """Return a signal's name as `kill` takes it."""
    return number.name.removeprefix("SIG")

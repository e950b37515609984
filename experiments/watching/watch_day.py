"""Watch a day: read rows as they arrive, judge each, and keep the state."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.arguments import expect
from tulip_testbed.base.errors import InputError, look_up, shortened
from tulip_testbed.base.files import read_bytes
from tulip_testbed.base.numbers import number
from tulip_testbed.base.result import Result
from tulip_testbed.base.resumable import alone_on
from tulip_testbed.base.table import Cell, Table
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.experiments.usable_plan import plan_hash
from tulip_testbed.experiments.watching import arriving_rows
from tulip_testbed.experiments.watching.arriving_rows import (
    NOTHING,
    Arrived,
    ArrivingRows,
    ArrivingSamples,
    Seen,
)
from tulip_testbed.experiments.watching.day_model import DayModel, day_model
from tulip_testbed.experiments.watching.row_columns import RowColumns, row_columns
from tulip_testbed.experiments.watching.watch_row import Verdict, rocking, spreads_of, watch_row
from tulip_testbed.experiments.watching.watch_state import begin_row, first_state
from tulip_testbed.identification.noise_in_time import WHITE, NoiseInTime
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.regressor import check_robot
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.data import stacked
from tulip_testbed.measurements.logs.series_reduction import usual_window
from tulip_testbed.measurements.manifest import Manifest
from tulip_testbed.measurements.measurement_folder import header_in, read_manifest
from tulip_testbed.sim.robot import Robot

POLL = 0.25  # s, between two looks at a file
EVERY = "all"
FIRST = 120  # rows of a motion, which show how long its noise lasts before any of them is judged
SHARES, SECONDS = (0.5, 0.8, 0.9, 0.95, 0.98), (0.5, 1.0, 1.4, 2.0, 2.8, 4.0, 8.0)
TRIED = (WHITE, *(NoiseInTime(*each) for each in product(SHARES, SECONDS)))


@dataclass(frozen=True, eq=False)
class Arrival:
    """The verdict on a line of the table, or the problem why it could not be read."""

    line: int
    verdict: Verdict | None
    problem: str = ""


class Watch(Result):
    """A day that is being watched: an iterator of what comes of every row, as soon as it is there.

    It ends when every posture of the plan is measured. The state is written after a row was yielded: a
    process that is killed between both yields that row again. A hidden file next to the state, .NAME.lock,
    keeps a second watch of the same state out.
    """

    def __init__(
        self,
        folder: Path,
        plan: PosturePlan,
        robot: Robot,
        out: Path | None = None,
        targets: Mapping[str, float] | None = None,
        once: bool = False,
    ) -> None:
        """Begin to watch; everything is looked at when the first row is asked for.

        Args:
            folder: measurement folder; nothing is written into it.
            out: file that keeps the state; None: it is not kept.
            targets: standard errors that are wanted, by base parameter or "all" [m].
            once: judge the rows that are there and end, rather than wait for more.
        """
        self.folder, self.plan, self.robot = folder, plan, robot
        self._out, self._targets, self._once = out, targets or {}, once
        self._last: Verdict | None = None
        self._rows = 0  # that arrived
        self._arrivals = self._judged()

    def __iter__(self) -> Iterator[Arrival]:
        return self

    def __next__(self) -> Arrival:
        arrival = next(self._arrivals)
        self._rows += 1
        if arrival.verdict is not None:
            self._last = arrival.verdict
        return arrival

    @property
    def exit_code(self) -> int:
        """Return 1 if rows arrived and none could be read, and else 0."""
        return int(self._last is None and self._rows > 0)

    def to_json(self) -> dict[str, Any]:
        """Return the document of the last verdict; empty before the first one."""
        return {} if self._last is None else self._last.to_json()

    def tables(self) -> list[Table | str]:
        """Return the standard errors with their targets, and what to do now."""
        if self._last is None:
            least = "No row has" if self.plan.motion is None else f"Fewer than {FIRST} rows have"
            return [] if self._rows else [f"{least} arrived."]
        figures = ("s.e.", "mm", ".2f", 1e3), ("target", "mm", ".2f", 1e3)
        heads, rows = (("no.", "", "d"), "parameter", *figures, "met"), []
        for k, (name, error) in enumerate(self._last.standard_errors.items(), 1):
            target = self._targets[name]
            met = Cell("yes", "pass") if error <= target else Cell("no", "warn")
            wanted = math.isfinite(target)
            rows.append([k, name, error, target if wanted else None, met if wanted else ""])
        note = "By the data sheets and the postures so far; the readings' scatter does not enter."
        return [Table("Standard errors of the base parameters", heads, rows, note), self.advice()]

    def advice(self) -> str:
        """Say what to do now, and how the standard errors stand."""
        if (last := self._last) is None:
            return ""
        told = [f"Stop: {last.stop}."] if last.stop else []
        if last.onset is not None:
            told.append(
                f"Something changed at posture {last.onset}: correct it and measure from there again."
            )
        if last.next is not None:
            again = " again" if last.next == last.posture else ""
            told.append(f"Next: posture {last.next}{again}; {last.left} left.")
        errors = last.standard_errors
        name = max(errors, key=lambda parameter: errors[parameter])
        if math.isfinite(errors[name]):
            told.append(f"Largest standard error: {number(1e3 * errors[name], '.2f')} mm ({name}).")
        else:
            told.append("The postures do not determine all base parameters yet.")
        if any(map(math.isfinite, self._targets.values())):
            missed = sum(error > self._targets[name] for name, error in errors.items())
            told.append(f"Targets that are not met: {missed} of {len(errors)}.")
        return " ".join(told)

    def _judged(self) -> Iterator[Arrival]:
        """Yield what comes of every row; those that a killed watch has seen are judged first, in silence.

        Rows of a motion wait until the first ones have shown how its noise lasts.
        """
        out, where = self._out, self.folder / "manifest.json"
        if out is not None:
            arriving_rows.check_state_file(out)
        with nullcontext() if out is None else alone_on(out):
            manifest = read_manifest(self.folder)
            model = self._model(manifest, where)
            self._targets = _targets_of(model.nominal.parameters.names, self._targets)
            targets = np.array(list(self._targets.values()))
            asked = plan_hash(self.plan) + (plan_hash(motion) if (motion := self.plan.motion) else "")
            day = sha256((stated := read_bytes(where)) + asked.encode()).hexdigest()
            kept = NOTHING if out is None else arriving_rows.read_state(out, day)
            state, judged = first_state(model), one_blas_thread(watch_row)
            rows, waiting, first = 0, list[Arrived](), 0 if model.held else FIRST
            for arrived in self._arriving(model, manifest, kept):
                if arrived.line.new and read_bytes(where) != stated:
                    raise InputError(f"{where}: found another manifest than before the first row")
                waiting.append(arrived)
                rows += arrived.row is not None
                if rows < first:
                    continue
                if rows == first and arrived.row is not None:
                    shown = stacked([one.row for one in waiting if one.row is not None])
                    model = one_blas_thread(with_noise_in_time)(model, shown)
                    state = first_state(model)
                for line, row, problem in waiting:
                    verdict = None
                    if row is not None:
                        state, verdict = judged(model, state, row, targets)
                    if line.new:
                        yield Arrival(line.number, verdict, problem)
                        if out is not None:
                            arriving_rows.write_state(out, day, line.seen)
                    if model.held and verdict is not None and verdict.next is None:
                        return
                waiting = []

    def _model(self, manifest: Manifest, where: Path) -> DayModel:
        """Prepare the day; refuse another robot's folder or plan, and sensors other than plates on cells."""
        if manifest.plates is None:
            raise InputError(
                f"{where}: key 'contacts': found sensors of wrenches, expected plates on four cells each: a "
                "watch reads no others yet"
            )
        header = header_in(manifest, where)
        nothing = Measurements.without_rows(header)
        check_robot(nominal_robot(self.robot).parameters, nothing, self.robot, str(self.folder))
        window = None
        if self.plan.motion is not None:
            window = manifest.motion.window if manifest.motion else None
            window = window or usual_window(header.sensors.encoder_resolution)
        return day_model(self.plan, self.robot, header, window)

    def _arriving(self, model: DayModel, manifest: Manifest, kept: Seen) -> Iterator[Arrived]:
        """Yield rows as they come; without end, unless those that are there are enough."""
        given = {"manifest": manifest, "where": self.folder / "manifest.json", "kept": kept}
        if model.window is None:
            rows = ArrivingRows(path=self.folder / arriving_rows.TABLE, once=self._once, **given)
        else:
            mass = manifest.weighed_mass.value if manifest.weighed_mass else model.nominal.mass
            path, weight = self.folder / arriving_rows.SAMPLES, mass * manifest.gravity
            rows = ArrivingSamples(path=path, weight=weight, window=model.window, **given)
        yield from rows.new()
        while not self._once:
            time.sleep(POLL)
            yield from rows.new()


def read_targets(texts: Sequence[str]) -> dict[str, float]:
    """Read targets that are written NAME=MILLIMETRES, by base parameter or "all" [m]."""
    targets: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        if name in targets:
            raise InputError(f"targets: {name}: found two values, expected one")
        try:
            targets[name] = 1e-3 * float(value)
        except ValueError:
            raise InputError(
                f"targets: found {shortened(repr(text))}, expected NAME=MILLIMETRES, for instance all=2"
            ) from None
    return targets


def _targets_of(names: Sequence[str], given: Mapping[str, float]) -> dict[str, float]:
    """Return the standard error that is wanted of every base parameter [m]; infinite: none is."""
    for name, value in given.items():
        look_up("parameter", name, (EVERY, *names), "targets")
        expect(f"targets: {name}", value, float)
        if not 0 < value < np.inf:
            raise InputError(f"targets: {name}: found {value:g}, expected a standard error above 0 [m]")
    return {name: given.get(name, given.get(EVERY, math.inf)) for name in names}


def with_noise_in_time(model: DayModel, rows: Measurements) -> DayModel:
    """Return the model of a moving day with the most likely correlation of the noise of its first rows.

    Args:
        rows: the first `FIRST` ones, so that the model does not depend on how many have arrived.
    """
    one_by_one = [rows.take(np.array([k])) for k in range(len(rows))]
    spreads = np.array([spreads_of(row) for row in one_by_one])
    rocks = np.array([rocking(row, spreads) for row in one_by_one])  # their twists are no noise
    columns = row_columns(model, rows).without_twist(rocks)
    return max((model.with_noise(one) for one in TRIED), key=lambda each: likelihood(each, rows, columns))


def likelihood(model: DayModel, rows: Measurements, columns: RowColumns) -> float:
    """Return ln of the likelihood of rows, but for a constant."""
    state, out = first_state(model), 0.0
    for k in range(len(rows)):
        state = begin_row(model, state, rows.take(np.array([k])), k)
        innovation = state.belief.predict(model, columns.row(k))
        _, volume = np.linalg.slogdet(innovation.covariance)
        out -= (innovation.chi_square + volume) / 2
        state = replace(state, belief=state.belief.updated(innovation))
    return out

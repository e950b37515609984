"""Days for the study of `tulip watch`: ordinary laboratories, and faults that begin in the middle."""

from dataclasses import dataclass, replace

import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.injection import edited
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.experiments.imperfections import ordinary_members
from tulip_testbed.experiments.laboratory import Laboratory
from tulip_testbed.experiments.watching.alarm import CHANGED, OK, largest_ratio
from tulip_testbed.experiments.watching.day_model import DayModel, day_model
from tulip_testbed.experiments.watching.row_columns import row_columns
from tulip_testbed.experiments.watching.watch_row import Verdict, watch_row
from tulip_testbed.experiments.watching.watch_state import RAMP, begin_row, first_state
from tulip_testbed.identification.distributions import chi2_isf
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.data import stacked
from tulip_testbed.sim.random_robots import draw_robot, edit_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.robot import load_robot

ONSET = 40  # posture from which a fault is there
POWER = 1.2816  # normal quantile: an MDE is found with 90 % probability
DETECTABLE = 1e-4  # p-value of the likelihood ratio with kind and onset known
ROBOTS = (0.05, 0.2)  # spread of masses and centres of mass
MULTIPLES = (4.0, 8.0)  # of the MDE
LEAST_STANDING = 100  # rows: a day with fewer would not go on
TRIES = 10


@dataclass(frozen=True)
class Kind:
    """A fault of the study.

    Attributes:
        label: effect and target. along: multiples of the plausible sizes. ramp: whether it grows.
        size: fixed, in plausible sizes; None: 4 to 8 MDE.
        watched: label of the direction that the watch knows it by; "": its own.
    """

    label: str
    along: tuple[float, ...] = (1.0,)
    ramp: bool = False
    size: float | None = None
    watched: str = ""


FAULTS = (
    Kind("encoder-slip:right_knee"),
    Kind("encoder-slip:left_hip_roll"),
    Kind("encoder-slip:left_ankle_pitch"),
    Kind("encoder-slip:right_ankle_roll"),
    Kind("encoder-gain:left_knee"),
    Kind("cell-gain:right.front_left"),
    Kind("cell-gain:left.rear_right"),
    # Its cable is off and it reads nothing, as if its zero had changed by its load.
    Kind("cell-gain:left.front_left", size=-20.0, watched="cell-tare:left.front_left"),
    Kind("cell-tare:left.front_right"),
    Kind("cell-tare:right.rear_right"),
    Kind("cell-drift:right.front_right", ramp=True, watched="cell-tare:right.front_right"),
    Kind("sole-compliance"),
    Kind("plate-translation:left", (1.0, 0.0)),
    Kind("plate-translation:right", (0.0, 1.0)),
    Kind("plate-yaw:left"),
    Kind("tilt", (0.0, 1.0)),
    Kind("tether", (1.0, 0.0)),
    Kind("payload-step:torso"),
    Kind("payload-step:left_lower_leg"),
    Kind("joint-compliance:right_knee"),
)
# Faults that grow slowly, which a watch notices late: a table of their own.
DRIFTS = (
    Kind("plate-drift:left", ramp=True),
    Kind("plate-drift:right", ramp=True),
    Kind("thermal-gain-drift", ramp=True),
    *(
        Kind(f"cell-drift:{cell}", ramp=True, watched=f"cell-tare:{cell}")
        for cell in ("left.front_left", "left.rear_left", "right.front_left", "right.rear_right")
    ),
)


@dataclass(frozen=True)
class Day:
    """A clean day, and the laboratory in which it was measured."""

    laboratory: Laboratory
    rows: Measurements
    stream: int
    engine: str


@dataclass(frozen=True)
class FaultyDay:
    """The result of a day with a fault.

    Attributes:
        multiple: of the MDE. detectable, noticed: rows; -1: never.
        told: the cause that was named. early: a false alarm before.
    """

    kind: Kind
    preset: str
    multiple: float
    detectable: int
    noticed: int
    told: str
    early: bool

    @property
    def late(self) -> int:
        """Return how many postures it was noticed after it was detectable; negative: before."""
        return self.noticed - self.detectable

    @property
    def hit(self) -> bool:
        """Return whether it was noticed within three postures, and nothing before it began."""
        return not self.early and 0 <= self.noticed <= self.detectable + 3


def ordinary_day(seed: int, preset: str, engine: str, plan: PosturePlan) -> Day:
    """Draw a random robot in an ordinary laboratory and measure a plan with it."""
    robot = load_robot()
    rng = np.random.default_rng([seed, len(preset)])
    for _ in range(TRIES):
        stream = int(rng.integers(2**31))
        spread = float(rng.uniform(*ROBOTS))
        rig = edited(preset_rig(preset, robot), edit_of(robot.model, draw_robot(robot.model, spread, rng)))
        laboratory = Laboratory(robot, preset, hidden=ordinary_members(rig, rng), nominal=rig)
        try:
            rows = laboratory.run(plan, stream, engine, workers=1).measurements
        except InputError:  # this robot falls
            continue
        if len(rows) >= LEAST_STANDING:
            return Day(laboratory, rows, stream, engine)
    raise InputError(f"seed {seed}: found no robot that stands")


def played(model: DayModel, rows: Measurements) -> list[Verdict]:
    """Play a day row by row; return the verdicts."""
    state, out = first_state(model), []
    for k in range(len(rows)):
        state, verdict = watch_row(model, state, rows.take(np.array([k])))
        out.append(verdict)
    return out


def alarms(verdicts: list[Verdict]) -> list[int]:
    """Return the rows that were not found in order."""
    return [k for k, one in enumerate(verdicts) if one.verdict != OK]


def known_ratio(model: DayModel, rows: Measurements, direction: int, onset: int) -> tuple[np.ndarray, float]:
    """Return the likelihood ratio of a fault whose kind and onset are known, after every row.

    The filter takes every row in.

    Returns:
        twice its logarithm, (m,), and all information on one plausible size.
    """
    columns, state = row_columns(model, rows), first_state(model)
    bias, pull, information = np.zeros(len(model.covariance)), 0.0, 0.0
    ratios = np.zeros(len(rows))
    for k in range(len(rows)):
        one = rows.take(np.array([k]))
        before = state.stance
        anew = int(one.placement[0]) != state.placement
        state = begin_row(model, state, one, int(model.first_rows(one)[0]))
        if state.stance != before:
            bias[-9 if anew else -3 :] = 0.0
        found = state.belief.predict(model, columns.row(k))
        if k >= onset:
            grown = (k - onset + 1) / RAMP if model.ramps[direction] else 1.0
            seen = grown * found.here.faults[:, direction] - found.here.state @ bias
            pull += float(found.value @ found.precision @ seen)
            information += float(seen @ found.precision @ seen)
            bias = bias + found.gain @ seen
        ratios[k] = pull**2 / information if information > 0 else 0.0
        state = replace(state, belief=state.belief.updated(found))
    return ratios, information


def direction_of(model: DayModel, kind: Kind) -> int:
    """Return the number of the direction by which the watch knows a fault."""
    label = kind.watched or kind.label
    for k, one in enumerate(model.directions):
        sizes = [one.values[number] for number in one.effect.sizes]
        along = [a != 0 for a in kind.along]
        if one.label == label and model.ramps[k] == kind.ramp and [s != 0 for s in sizes] == along:
            return k
    raise AssertionError(label)


def faulty_day(day: Day, kind: Kind, plan: PosturePlan, seed: int) -> FaultyDay:
    """Let a fault begin at posture `ONSET` of a day and play it."""
    rng = np.random.default_rng([seed, 99])
    model = day_model(plan, day.laboratory.robot, day.rows)
    start = float(day.rows.time[day.rows.posture >= ONSET].min())
    began = int((day.rows.time < start).sum())
    direction = direction_of(model, kind)
    _, information = known_ratio(model, day.rows, direction, began)
    threshold = largest_ratio(model)
    mde = (np.sqrt(threshold) + POWER) / np.sqrt(information)
    multiple = float(np.exp(rng.uniform(*np.log(MULTIPLES))))
    effect = model.directions[direction].effect
    # A mass that is taken away may be more than the link has.
    positive = effect.name == "payload-step" or any(p.positive for p in effect.parameters)
    size = multiple * mde * (1.0 if positive else float(rng.choice([-1.0, 1.0])))
    if kind.size is not None:
        size, multiple = kind.size, np.inf
    rows = with_fault(day, kind, size, plan, start)
    ratios, _ = known_ratio(model, rows, direction, began)
    verdicts = played(model, rows)
    odd = alarms(verdicts)
    later = [k for k in odd if k >= began]
    found = np.flatnonzero(ratios > float(chi2_isf(DETECTABLE, 1)))
    changed = [v for v in verdicts[began:] if v.verdict == CHANGED]
    named = next((f.seen for v in changed for f in v.findings if f.name == "change"), "")
    return FaultyDay(
        kind=kind,
        preset=day.laboratory.sensors,
        multiple=multiple,
        detectable=int(found[0]) if len(found) else -1,
        noticed=later[0] if later else -1,
        told=named.partition("best explanation: ")[2].rpartition(": ")[0],
        early=bool(odd and odd[0] < began),
    )


def with_fault(day: Day, kind: Kind, size: float, plan: PosturePlan, start: float) -> Measurements:
    """Return the day with the fault from a time on.

    Instruments misread the rows from then on; what acts on the robot is simulated, with the same random
    numbers, and takes their place. A ramp begins at zero then.

    Args:
        size: in plausible sizes; of a ramp, in ten postures. start: [s].
    """
    before, after = day.rows.time < start, day.rows.time >= start
    name, _, target = kind.label.partition(":")
    effect = catalogue()[name]
    if kind.ramp:
        size *= (after.sum() - 1) / RAMP * _same_unit(kind)
    along = iter(kind.along)
    values = tuple(
        size * next(along) * p.prior if k in effect.sizes else 0.0 for k, p in enumerate(effect.parameters)
    )
    if effect.misreads:
        rig = preset_rig(day.laboratory.sensors, day.laboratory.robot)
        misread = effect.inject(rig, target, values).misread
        assert misread is not None
        return stacked([day.rows.take(before), misread(day.rows.take(after))])
    if "start" in (names := [p.name for p in effect.parameters]):
        late = 0.1  # before that part of the run which is used
        values = tuple(late if n == "start" else v for n, v in zip(names, values, strict=True))
    others = tuple(one for one in day.laboratory.hidden if one.label != kind.label)
    for one in day.laboratory.hidden:  # what was there before grows
        if one.label == kind.label:
            values = tuple(a + b for a, b in zip(one.values, values, strict=True))
    laboratory = replace(day.laboratory, hidden=(*others, EffectInstance(effect, target, values)))
    faulty = laboratory.run(plan, day.stream, day.engine, workers=1).measurements
    return stacked([day.rows.take(before), faulty.take(faulty.time >= start)])


def _same_unit(kind: Kind) -> float:
    """Return a plausible size of the direction in plausible sizes of the effect that is simulated."""
    if not kind.watched:
        return 1.0
    own, watched = (catalogue()[label.partition(":")[0]] for label in (kind.label, kind.watched))
    return watched.parameters[0].prior / own.parameters[0].prior

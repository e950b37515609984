"""Effects on the load cells of the plates."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import mujoco
import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import always, edited, indicator, successive
from tulip_testbed.effects.lasting import Lasting
from tulip_testbed.effects.misreading import InstrumentFault, added, mapped, scaled
from tulip_testbed.effects.targets import CELL_NAMES, PLATE_NAMES
from tulip_testbed.effects.wandering import WANDERING, wandering, waves
from tulip_testbed.identification.observation import Observation, turned
from tulip_testbed.identification.residual_channels import TWIST
from tulip_testbed.measurements.cells import CELLS, CORNERS, PLATES
from tulip_testbed.sim.plates import cell_names
from tulip_testbed.sim.rig import Rig

FORCES = "cell_forces"


def _cell(fault: InstrumentFault) -> np.ndarray:
    return indicator(CELLS, fault.target)


def _four(fault: InstrumentFault) -> np.ndarray:
    return np.repeat(indicator(PLATES, fault.target), len(CORNERS))


def _mixing(fault: InstrumentFault) -> np.ndarray:
    """Return the readings of a plate's cells per load on each, (4, 4), symmetric."""
    return (1 - fault.size) * np.eye(4) + fault.size


def _mixed(forces: np.ndarray, by: np.ndarray) -> np.ndarray:
    return (forces.reshape(-1, 2, 4) @ by).reshape(-1, 8)


def _lag(load: np.ndarray, fault: InstrumentFault) -> np.ndarray:
    before = np.zeros_like(load)
    for previous, row in successive(fault.measurements):
        before[row] = load[previous]
    return load + fault.size * (before - load)


def _without_lag(read: np.ndarray, fault: InstrumentFault) -> np.ndarray:
    fraction = fault.size
    load = read / (1 - fraction)
    for previous, row in successive(fault.measurements):
        load[row] -= fraction / (1 - fraction) * load[previous]
    return load


def _creep(load: np.ndarray, fault: InstrumentFault) -> np.ndarray:
    cell, read, size = CELLS.index(fault.target), load.copy(), fault.size
    creep, before = 0.0, 0.0
    for row, kept in _intervals(fault.time, fault.values[1]):
        creep = kept * creep + (1 - kept) * size * (before + load[row, cell]) / 2
        read[row, cell], before = load[row, cell] + creep, load[row, cell]
    return read


def _without_creep(read: np.ndarray, fault: InstrumentFault) -> np.ndarray:
    cell, forces, size = CELLS.index(fault.target), read.copy(), fault.size
    loads, creep, before = read[:, cell].tolist(), 0.0, None
    for row, kept in _intervals(fault.time, fault.values[1]):
        grown = (1 - kept) * size / 2  # creep by each of the two loads
        reading = loads[row] - kept * creep
        # A part of an experiment begins later: the cell bore its first load until then.
        load = reading / (1 + 2 * grown) if before is None else (reading - grown * before) / (1 + grown)
        creep = loads[row] - load
        loads[row] = before = load
    forces[:, cell] = loads
    return forces


def _intervals(time: np.ndarray, constant: float) -> list[tuple[int, float]]:
    """Return the rows in the order of time, each with the part of the creep kept since the one before."""
    order = np.argsort(time, kind="stable")
    kept = np.exp(-np.diff(time[order], prepend=0.0) / constant)
    return list(zip(order.tolist(), kept.tolist(), strict=True))


def _swapped(forces: np.ndarray, fault: InstrumentFault) -> np.ndarray:
    columns = np.arange(forces.shape[1])
    pair = len(CORNERS) * PLATES.index(fault.target) + np.array(fault.values, dtype=int)
    columns[pair] = pair[::-1]
    return forces[:, columns]


def _spread(rig: Rig, target: str, values: Values) -> Rig:
    return _placed(rig, cell_names(), lambda place: place * [1 + values[0], 1 + values[0], 1.0])


def _aside(rig: Rig, target: str, values: Values) -> Rig:
    return _placed(rig, [cell_names()[CELLS.index(target)]], lambda place: place + np.append(values, 0.0))


def _placed(rig: Rig, cells: list[str], move: Callable[[np.ndarray], np.ndarray]) -> Rig:
    def edit(spec: mujoco.MjSpec) -> None:
        for name in cells:
            hung = spec.body(f"{name}_cell")  # compliant cells are bodies of their own
            for part in [spec.geom(name), spec.site(name)] if hung is None else [hung]:
                part.pos = move(part.pos)

    return edited(rig, edit)


def _on_their_sides(rig: Rig, target: str, values: Values) -> Rig:
    def change(one: Rig) -> Rig:
        parts = np.array(one.side_forces)
        parts[PLATES.index(target)] += values
        right, left = parts.tolist()
        return replace(one, side_forces=(tuple(right), tuple(left)))

    return always(rig, change)


def _without_side_forces(observed: Observation, target: str, values: Values) -> Observation:
    """Take off what the plate reads of the ground's horizontal force on its foot."""
    side = PLATES.index(target)
    push = turned(-observed.contact_poses[:, side, 2], observed.loads.sideways[:, side])
    forces = observed.cell_forces.copy()
    forces.reshape(-1, 2, 4)[:, side] -= (push @ values)[:, None] / len(CORNERS)
    return observed.changed(cell_forces=forces)


def _with_true_places(observed: Observation, target: str, values: Values) -> Observation:
    return observed.changed(cells=observed.cells * (1 + values[0]))


def _as_at_stated_place(observed: Observation, target: str, values: Values) -> Observation:
    """Return what cells at their stated places would read of the same load, moment and twist of the board."""
    side, corner = divmod(CELLS.index(target), len(CORNERS))
    stated, forces = observed.cells[side], observed.cell_forces.copy()
    true = stated + np.outer(indicator(CORNERS, CORNERS[corner]), values)
    by = np.linalg.solve(_loads_of(stated), _loads_of(true))
    forces.reshape(-1, 2, len(CORNERS))[:, side] @= by.T
    return observed.changed(cell_forces=forces)


def _loads_of(places: np.ndarray) -> np.ndarray:
    """Return load, moments and twist of a board per force on each of its cells, (4, 4)."""
    wrench = np.vstack([np.ones(len(CORNERS)), places.T])
    twist = np.linalg.svd(wrench)[2][-1]  # forces without load and moment
    return np.vstack([wrench, twist * (TWIST @ TWIST) / (TWIST @ twist)])


_on_cell = partial(Effect, targets=CELL_NAMES, instrument="cells")
_on_plate = partial(Effect, targets=PLATE_NAMES, instrument="cells")
_on_cells = partial(Effect, instrument="cells")


EFFECTS = (
    _on_cell(
        name="cell-gain",
        sentence="A load cell reads (1 + gain) times its load.",
        parameters=(Parameter("gain", "", prior=0.05),),
        mechanism=scaled(FORCES, lambda fault: 1 + fault.size * _cell(fault)),
        words="The {target} cell reads {0} too much.",
        explanation="A load cell reads a multiple of its load: its calibration is wrong.",
    ),
    _on_cell(
        name="cell-tare",
        sentence="A load cell reads a constant force too much.",
        parameters=(Parameter("tare", "N", prior=1.0),),
        mechanism=added(FORCES, lambda fault: fault.size * _cell(fault)),
        words="The {target} cell reads {0} too much at any load.",
        lasting=Lasting(until="tare"),
        explanation="""A load cell reads a constant force too much: its zero is wrong.

        The sum of the cells shows the error against the weighed mass. The shift of the centre of pressure is
        nearly the same in all postures, so the base parameters absorb it.
        """,
    ),
    _on_cell(
        name="cell-drift",
        sentence="A load cell's zero drifts steadily, from 0 at the first posture to this at the last.",
        parameters=(Parameter("drift", "N", prior=2.0),),
        mechanism=added(FORCES, lambda fault: fault.size * np.outer(fault.time, _cell(fault))),
        words="The zero of the {target} cell drifts by {0} over the experiment.",
        explanation="A load cell's zero drifts steadily: the cell was tared at the start of the experiment.",
    ),
    _on_cell(
        name="cell-wander",
        sentence="A load cell has a zero that wanders slowly, about a mean of zero.",
        parameters=waves("N", prior=1.0),
        mechanism=added(FORCES, lambda fault: np.outer(wandering(fault), _cell(fault))),
        words="The zero of the {target} cell wanders slowly: {0}, {1}, {2} and {3} of the waves of its path.",
        lasting=Lasting(until="session"),
        searched=False,
        explanation=WANDERING,
    ),
    _on_plate(
        name="plate-drift",
        sentence="The zeros of a plate's four cells drift steadily, each from 0 at the first posture to this "
        "at the last.",
        parameters=(Parameter("drift", "N", prior=1.0),),
        mechanism=added(FORCES, lambda fault: fault.size * np.outer(fault.time, _four(fault))),
        words="The zeros of all cells of the {target} plate drift by {0} each over the experiment.",
        lasting=Lasting(moves="plate"),
        explanation="""The zeros of a plate's four cells drift together: they share an amplifier and a
        temperature.

        One rate for all four: what the cells have in common moves the sum of the forces four times as much as
        one cell would, leaves the twist of the board as it is, and pulls the centre of pressure to that
        plate's centre.
        """,
    ),
    _on_cells(
        name="common-gain",
        sentence="All cells read too much by this share of their load.",
        parameters=(Parameter("gain", "", prior=0.02),),
        mechanism=scaled(FORCES, lambda fault: np.full(len(CELLS), 1 + fault.size)),
        words="All cells read too much by {0} of their load, or the weighed mass is wrong.",
        explanation="""The gain of all load cells is off alike: they share a reference voltage, or the scale
        with which the robot was weighed errs.

        The centre of pressure stays where it is; only the sum of the cells against the weighed mass shows it.
        """,
    ),
    _on_cells(
        name="thermal-gain-drift",
        sentence="The gain of all cells grows steadily, from 1 at the first posture to 1 + gain at the last.",
        parameters=(Parameter("gain", "", prior=0.01),),
        mechanism=scaled(FORCES, lambda fault: 1 + fault.size * fault.time[:, None]),
        words="The gain of all cells drifts by {0} over the experiment.",
        explanation="""The gain of all load cells drifts steadily: the amplifier or the cells warm up.

        A gain that is the same in all cells does not move the centre of pressure; only the sum of the cells
        shows it.
        """,
    ),
    _on_cells(
        name="cell-crosstalk",
        sentence="Every cell also reads a fraction of the loads on the other three cells of its plate.",
        parameters=(Parameter("crosstalk", "", prior=0.02),),
        mechanism=mapped(
            FORCES,
            lambda load, fault: _mixed(load, _mixing(fault)),
            lambda read, fault: _mixed(read, np.linalg.inv(_mixing(fault))),
        ),
        words="Every cell also reads {0} of the loads on the other three cells of its plate.",
        explanation="""The load cells of a plate influence each other: they share an excitation, or the plate
        bends.

        Each cell reads its own load and this fraction of the loads on the other three cells of its plate. The
        sum of the cells grows by three times the fraction, and the centre of pressure of each foot is drawn
        towards the centre of its plate.
        """,
    ),
    _on_cells(
        name="cell-hysteresis",
        sentence="The cells lag behind by a fraction of the last change of their load.",
        parameters=(Parameter("part", "", prior=0.01),),
        mechanism=mapped(FORCES, _lag, _without_lag),
        words="The cells lag behind by {0} of the last change of their load.",
        explanation="""The load cells lag behind their load: hysteresis or creep.

        reading = load + fraction (previous load - load). The previous load is that of the preceding row in
        the order of time, even if a posture was tried in between and dropped. Where the robot was set down
        again (another placement or support) the plates were empty before, so the previous load is 0.
        """,
    ),
    _on_cell(
        name="creep",
        sentence="A load cell's reading grows towards (1 + size) times its load, with a time constant "
        "given as a fraction of the experiment's time.",
        parameters=(
            Parameter("size", "", prior=0.01),
            Parameter("constant", "", grid=(0.03, 0.1, 0.3), smooth=True),
        ),
        mechanism=mapped(FORCES, _creep, _without_creep),
        words="The {target} cell creeps by {0} of its load, with the time constant {1} of the experiment's "
        "time.",
        lasting=Lasting(in_sequence=True),
        explanation="""A load cell creeps: under a constant load its reading keeps growing.

        reading = load + creep, and the creep follows size times the load with one time constant. Real cells
        need several exponentials (Bartel and Yaniv 1997 fitted 65 cells). OIML R 60 limits what a reading
        changes within 30 minutes of loading: the time constants are tens of minutes. The size is one of cheap
        cells, assumed. The creep is zero at the first posture. Between two readings the cell bears the mean
        of their loads. That holds for the breaks too in which the robot is set down again: they are short
        against the time constant, so the recovery of an empty cell is left out.
        """,
    ),
    _on_plate(
        name="cell-side-force",
        sentence="A plate's cells also read parts of its side force on the foot, along the plate's x and y.",
        parameters=(Parameter("x", "", prior=0.05), Parameter("y", "", prior=0.05)),
        mechanism=Physics(_on_their_sides, _without_side_forces),
        words="The cells of the {target} plate also read {0} of its side force along x and {1} along y.",
        lasting=Lasting(moves="plate", on_axes=True),
        explanation="""The cells of a plate also read parts of the horizontal force between plate and foot.

        The side force is that of the plate on the foot, in the plate's axes. The four cells read these parts
        of it together, a quarter each. In double support the closed legs push each other sideways: the sum of
        the cells errs with the posture, and the centre of pressure is drawn towards the plate's centre, or
        away from it. In single support on a level floor there is no side force.

        A calibrated sensor reads 1 % of another channel's range, one that is not corrected by a matrix up to
        5 % (me-systeme.de, *Accuracy of multi-component sensors*). How plain cells share it is assumed. The
        removal computes the side force from the nominal robot, its servos and the cells.
        """,
    ),
    _on_plate(
        name="swapped-cells",
        sentence="Two cells of a plate are swapped.",
        parameters=(
            Parameter("first", "", grid=(0, 1, 2), choices=CORNERS),
            Parameter("second", "", grid=(1, 2, 3), choices=CORNERS),
        ),
        mechanism=mapped(FORCES, _swapped, _swapped),
        words="The {0} and {1} cells of the {target} plate are swapped.",
        lasting=Lasting(moves="plate and corners"),
        explanation="""Two load cells of a plate are swapped: each is connected to the other's channel.

        There is no size to estimate. A search tries all pairs of the two grids: the six different pairs, and
        three that change nothing or repeat another pair.
        """,
    ),
    _on_cell(
        name="cell-position",
        sentence="A load cell lies off its stated place, along the plate's x and y.",
        parameters=(Parameter("x", "m", prior=0.005), Parameter("y", "m", prior=0.005)),
        mechanism=Physics(_aside, _as_at_stated_place),
        words="The {target} cell lies {0} along x and {1} along y off its stated place.",
        lasting=Lasting(on_axes=True),
        explanation="""A load cell is mounted off its stated place, along the plate's axes.

        The centre of pressure errs by the displacement times the cell's share of the load, so the more the
        nearer the foot stands to the cell. The sum of the cells is right.
        """,
    ),
    _on_cells(
        name="cell-position-scale",
        sentence="The cells lie at (1 + scale) times their stated distances from the centres of their "
        "plates.",
        parameters=(Parameter("scale", "", prior=0.02),),
        mechanism=Physics(_spread, _with_true_places),
        words="The cells lie {0} further from the centres of their plates than stated.",
        explanation="""All load cells are further from the centres of their plates than the data sheet says,
        by one ratio.

        The error stretches the centre of pressure of each foot about the centre of its plate.
        """,
    ),
)

"""Effects on how the feet stand: soles that yield, something under a corner, a board that rocks."""

from dataclasses import replace
from functools import partial

import mujoco
import numpy as np
from scipy.special import ndtr

from tulip_testbed.effects.effect import Effect, Parameter, Physics, Values
from tulip_testbed.effects.injection import always, edited
from tulip_testbed.effects.targets import CELL_NAMES, FEET, FOOT_CORNERS
from tulip_testbed.identification.observation import Observation, turned
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.measurements.data import base_foot
from tulip_testbed.sim.compliance import RIGID
from tulip_testbed.sim.rig import Rig

BALANCED = 0.0005  # m, s.d. of the strip about the diagonal in which a board may rest in between, assumed
ROCKING = 0.001  # m, the same for a foot


def _soften_soles(rig: Rig, target: str, values: Values) -> Rig:
    names = tuple(f"{target}_{axis}" for axis in ("roll", "pitch")) if target else ("sole_tilt",)
    more = {name: value for name, value in zip(names, values, strict=True) if value >= RIGID}

    def softer(one: Rig) -> Rig:
        before = one.compliance
        return replace(
            one,
            compliance=replace(before, **{name: getattr(before, name) + more[name] for name in more}),
        )

    return always(rig, softer) if more else rig


def _with_lean(observed: Observation, target: str, values: Values) -> Observation:
    softness = np.zeros((2, 2))  # of both soles about x and y
    softness[PLATES.index(target) if target else slice(None)] = values
    # Load to the front turns about +y, load to the left about -x.
    about = softness * np.array([-1.0, 1.0])
    return rocked(
        leaned(observed, about * observed.sole_loads[..., ::-1]),
        about * observed.motion.load_rates[:, :2, :, ::-1],
    )


def rocked(leaning: Observation, turning: np.ndarray) -> Observation:
    """Return the observation of a body that is accelerated as the foot that bears it rocks.

    Rate and acceleration of both feet's roll and pitch are (m, 2, 2, 2) [rad/s, rad/s2].
    """
    if not turning.any():
        return leaning
    foot = base_foot(leaning.measurements.support)
    added = leaning.motion.rocking @ turning[np.arange(len(foot)), :, foot].reshape(len(foot), 4, 1)
    return leaning.accelerated(added[..., 0])


def leaned(observed: Observation, lean: np.ndarray) -> Observation:
    """Return the observation with both feet leaned about the centres of their soles, (m, 2, 2) [rad]."""
    stance, swing = ((lean * observed.nominal.sole_rises).sum(axis=2)).T
    return observed.changed(
        cell_forces=observed.seen_from(lean) if observed.upright else observed.cell_forces,
        stance_tilt=observed.stance_tilt + lean[:, 0],
        swing_tilt=observed.swing_tilt + lean[:, 1],
        swing_rise=observed.swing_rise + swing - stance,
    )


def _tilted(observed: Observation, side: int, tilt: np.ndarray, rise: np.ndarray) -> Observation:
    """Return the observation with a foot tilted, (m, 2) [rad], and its sole point raised, (m,) [m]."""
    if side == 0:
        return observed.changed(
            stance_tilt=observed.stance_tilt + tilt, swing_rise=observed.swing_rise - rise
        )
    return observed.changed(swing_tilt=observed.swing_tilt + tilt, swing_rise=observed.swing_rise + rise)


def _share(place: np.ndarray, strip: float, noise: np.ndarray, spread: float) -> np.ndarray:
    """Return how far what stands on a diagonal is tipped to the side of its load, from 0 to 1, (m,).

    Args:
        place: of the load, from the diagonal, (m,) [m]. noise: its s.d., (m,) [m].
        strip: s.d. of the strip about the diagonal in which it may rest in between [m].
        spread: s.d. by which it is more tipped than on average.
    """
    share = ndtr(place / np.hypot(strip, noise))
    return share + spread * np.sqrt(share * (1 - share))


def _raise_corner(rig: Rig, target: str, values: Values) -> Rig:
    geom, thickness = target.replace(".", "_"), values[0]

    def edit(spec: mujoco.MjSpec) -> None:
        corner = spec.geom(geom)
        corner.pos = corner.pos - np.array([0.0, 0.0, thickness])

    def tolerant(one: Rig) -> Rig:
        limit = one.protocol.lift_limit + 2 * thickness
        return replace(one, protocol=replace(one.protocol, lift_limit=limit))

    return always(edited(rig, edit), tolerant)


def _on_corner(observed: Observation, target: str, values: Values, spread: float = 0.0) -> Observation:
    foot, _, corner = target.partition(".")
    side = observed.nominal.robot.feet.index(foot)
    down = observed.foot_loads[0][:, side]
    center = observed.sole_loads[:, side] / np.where(np.abs(down) > 1e-6, down, np.inf)[:, None]
    center = center + observed.nominal.sole_centers[side]
    reach = np.linalg.norm(observed.cells[side]) / np.sqrt(2)  # of the four cells together, along one axis
    noise = observed.cell_sd * reach / np.maximum(down, 1e-6)
    tilt, rise = _attitude(observed.nominal.soles[side], CORNERS.index(corner), center, noise, spread)
    return _tilted(observed, side, values[0] * tilt, values[0] * rise)


def _attitude(
    corners: np.ndarray, lifted: int, center: np.ndarray, noise: np.ndarray, spread: float
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the attitude of a foot per thickness under one of its corners.

    Args:
        corners: of the sole from the sole point, (4, 2) [m].
        lifted: index of the corner.
        center: centre of pressure from the sole point, (m, 2) [m]. noise: its s.d., (m,) [m].
        spread: s.d. by which it stands more on one side than on average.

    Returns:
        Roll and pitch, (m, 2) [rad/m], and rise of the sole point, (m,).
    """
    opposite, *between = ((lifted + k) % 4 for k in (2, 1, 3))
    along = corners[opposite] - corners[lifted]
    planes = []
    for third in between:
        points = np.column_stack([corners[[lifted, third, opposite]], np.ones(3)])
        planes.append(np.linalg.solve(points, [1.0, 0.0, 0.0]))  # height over the ground = a x + b y + c
    normal = np.array([-along[1], along[0]])
    normal = normal * np.sign((corners[between[0]] - corners[lifted]) @ normal) / np.linalg.norm(normal)
    share = _share((center - corners[lifted]) @ normal, ROCKING, noise, spread)
    a, b, c = np.outer(planes[0], share) + np.outer(planes[1], 1 - share)
    return np.column_stack([b, -a]), c


def _shorten_foot(rig: Rig, target: str, values: Values) -> Rig:
    plate, _, corner = target.partition(".")

    def edit(spec: mujoco.MjSpec) -> None:
        cell = spec.geom(f"{plate}_plate_{corner}")
        cell.pos = cell.pos + np.array([0.0, 0.0, values[0]])

    return edited(rig, edit)


def _level(observed: Observation, target: str, values: Values, spread: float = 0.0) -> Observation:
    plate, _, corner = target.partition(".")
    side = PLATES.index(plate)
    short, left, _, right = np.roll(observed.cells[side], -CORNERS.index(corner), axis=0)
    along = (right - left) / np.linalg.norm(right - left)
    across = np.array([-along[1], along[0]])
    away = (short - left) @ across  # of the short foot from the diagonal
    forces = observed.cell_forces.reshape(-1, 2, 4)[:, side]
    load = np.maximum(forces.sum(axis=1) + 4 * observed.board_share[side], 1e-6)
    levers = (observed.cells[side] - left) @ across
    towards = forces @ levers / load * np.sign(away)  # the board's own weight lies on the diagonal
    noise = observed.cell_sd * np.linalg.norm(levers) / load
    tipped = _share(towards, BALANCED, noise, spread) * values[0] / away
    yaw = observed.plate_poses[:, side, 2]
    # Downhill direction of the board in the base frame times its slope; it rises the other way.
    slope = tipped[:, None] * turned(yaw, across)
    pivot = observed.plate_poses[:, side, :2] + turned(yaw, left)
    tilt = np.column_stack([-slope[:, 1], slope[:, 0]])
    if side == 0:
        return _tilted(observed, side, tilt, (slope * pivot).sum(axis=1))
    place, turn = observed.swing_sole
    into_the_foot = -np.arctan2(turn[:, 1, 0], turn[:, 0, 0])
    rise = -(slope * (place[:, :2] - pivot)).sum(axis=1)
    return _tilted(observed, side, turned(into_the_foot, tilt), rise)


EFFECTS = (
    Effect(
        name="sole-compliance",
        sentence="Both soles yield in roll and pitch about their centres.",
        parameters=(Parameter("compliance", "rad/Nm", prior=np.radians(0.05), positive=True),),
        mechanism=Physics(_soften_soles, _with_lean),
        words="The soles of both feet yield by {0}.",
        explanation="""The soles of both feet yield under load: a rubber layer tilts as the centre of pressure
        moves.

        The foot leans towards its load, about the centre of its sole, and with it the point below the ankle
        rises or sinks. The compliance is added to the one that the robot's description states.
        """,
    ),
    Effect(
        name="foot-compliance",
        sentence="One foot rocks on its sole: it yields in roll and in pitch, by two compliances.",
        parameters=tuple(
            Parameter(f"about {axis}", "rad/Nm", prior=np.radians(0.05), positive=True) for axis in "xy"
        ),
        mechanism=Physics(_soften_soles, _with_lean),
        words="The {target} foot rocks on its sole by {0} in roll and {1} in pitch.",
        targets=FEET,
        instrument="feet",
        explanation="""One foot rocks on its sole, as `sole-compliance` of this foot alone, with two axes that
        differ: a foot is longer than wide, and its sole may be worn.

        A force-torque sensor in the foot shows the moment that turns it. While the robot stands on this foot,
        the centre of mass moves by its height times the angle, so the foot makes every displacement of the
        load larger.
        """,
    ),
    Effect(
        name="lifted-corner",
        sentence="Something of this thickness lies under a corner of a foot's sole.",
        parameters=(Parameter("thickness", "m", prior=0.001, positive=True),),
        mechanism=Physics(_raise_corner, _on_corner, partial(_on_corner, spread=1.0)),
        words="Something {0} thick lies under the {target} corner.",
        targets=FOOT_CORNERS,
        statics=False,
        instrument="cells",
        explanation="""Something lies under a corner of a foot's sole: a cable, a stone or a bent edge.

        The foot stands on three corners: that one, the opposite one, and of the other two the one on the same
        side of the diagonal as the centre of pressure. So it is tilted about one of two edges. In closed legs
        the foot usually rocks until its centre of pressure lies on the diagonal and then rests anywhere in
        between. The cells show within their noise on which side it lies: the prediction is the mean of where
        the foot rests, and `unsure` the spread about it.
        """,
    ),
    Effect(
        name="rocking",
        sentence="A plate's board rocks on its diagonal, because its foot at this cell is too short by this "
        "gap.",
        parameters=(Parameter("gap", "m", prior=0.0003, positive=True),),
        mechanism=Physics(_shorten_foot, _level, partial(_level, spread=1.0)),
        words="The board rocks: its foot at the {target} cell is too short by {0}.",
        targets=CELL_NAMES,
        instrument="cells",
        explanation="""A plate's board rocks on its diagonal: its foot at one cell is too short by a gap.

        A rigid board stands on three feet: the two next to the short one, and of the short one and its
        opposite that on the side of the diagonal where the load lies. With the load at the short foot it tips
        about the diagonal by the gap over the foot's distance from the diagonal; otherwise it is level. The
        robot's foot tilts with the board, and the cell that hangs in the air bears nothing. The size, a few
        tenths of a millimetre as of feet that nobody adjusted, is assumed.

        In closed legs the load may come to lie on the diagonal, the more often the wider the gap. Then the
        board rests anywhere in between. The cells show within their noise on which side the load lies: the
        prediction is the mean of where the board rests, and `unsure` the spread about it.

        `lifted-corner` is the other way round: there something lies under a sole, the board is level and the
        foot rocks.
        """,
    ),
)

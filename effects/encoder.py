"""Effects on the encoders of joints."""

from dataclasses import replace
from functools import partial

import numpy as np

from tulip_testbed.effects.effect import Effect, Parameter, Values
from tulip_testbed.effects.injection import STARTS, indicator, successive
from tulip_testbed.effects.lasting import Lasting
from tulip_testbed.effects.misreading import InstrumentFault, Misreading, added, mapped, scaled
from tulip_testbed.effects.targets import JOINTS, LEG_JOINTS, plate_of
from tulip_testbed.effects.wandering import WANDERING, wandering, waves
from tulip_testbed.identification.joint_loads import servo_stiffness
from tulip_testbed.identification.observation import Observation
from tulip_testbed.measurements import Measurements
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.sim.control import Controller
from tulip_testbed.sim.robot import Robot

ANGLES = "joint_angles"
SOURCES = ("encoder", "command")
# Of its limit: what dry friction has at rest after a movement, and its s.d.; assumed.
OPPOSED, UNKNOWN = 0.8, 0.5
ROUNDING = 1e-5  # rad, of a log; servos err by a hundred times as much


def _joint(fault: InstrumentFault) -> np.ndarray:
    return indicator(fault.joints, fault.target)


def _slip(fault: InstrumentFault) -> np.ndarray:
    slip, start = fault.values
    return slip * np.outer(fault.time >= start, _joint(fault))


def _by_load(fault: InstrumentFault) -> np.ndarray:
    side = PLATES.index(plate_of(fault.robot, fault.target))
    return fault.size * np.outer(fault.down[:, side], _joint(fault))


def _lag(angles: np.ndarray, fault: InstrumentFault) -> np.ndarray:
    joint, read = fault.joints.index(fault.target), angles.copy()
    for previous, row in successive(fault.measurements):
        read[row, joint] += fault.size * (angles[previous, joint] - angles[row, joint])
    return read


def _without_lag(read: np.ndarray, fault: InstrumentFault) -> np.ndarray:
    joint, angles, part = fault.joints.index(fault.target), read.copy(), fault.size
    for previous, row in successive(fault.measurements):
        angles[row, joint] = (angles[row, joint] - part * angles[previous, joint]) / (1 - part)
    return angles


def _log_command(m: Measurements, robot: Robot, target: str, values: Values) -> Measurements:
    if m.command is None or not values[0]:
        return m
    at = m.joints.index(target)
    angles, spread = m.joint_angles.copy(), m.joint_angles_sd.copy()
    angles[:, at], spread[:, at] = m.command[:, at], 0.0
    return replace(m, joint_angles=angles, joint_angles_sd=spread)


def _restore_angle(observed: Observation, target: str, values: Values) -> Observation:
    m, at = observed.measurements, observed.tree.joints.index(target)
    if m.command is None or not values[0]:
        return observed
    command, angles, torque = m.command[:, at], observed.joint_angles.copy(), observed.torques[:, at]
    # What yields beyond the encoder has no part in the servo's error. The load turns the joint its own way.
    if m.motor is None:
        motor = command + (torque + _friction(observed, at)[0]) / observed.servo_gain[at]
    else:
        motor = m.motor[:, at]
    turned, wind_up = motor, observed.nominal.robot.settings.get("drives", {}).get("wind_up")
    if wind_up:
        full = servo_stiffness(observed.nominal.robot, {})[at] * Controller().error_at_full_torque
        turned = motor + wind_up * torque / full
    angles[:, at] = turned if _is_command(m, at) else angles[:, at] + command - turned
    return observed.changed(joint_angles=angles)


def _off_friction(observed: Observation, target: str, values: Values) -> Observation:
    """Return the restored angles off by what is not known of the joint's dry friction."""
    restored, m = _restore_angle(observed, target, values), observed.measurements
    at = observed.tree.joints.index(target)
    if not values[0] or m.motor is not None or not _is_command(m, at):
        return restored
    angles = restored.joint_angles.copy()
    angles[:, at] += _friction(observed, at)[1] / observed.servo_gain[at]
    return restored.changed(joint_angles=angles)


def _is_command(m: Measurements, at: int) -> bool:
    return m.command is not None and bool((np.abs((m.joint_angles - m.command)[:, at]) < ROUNDING).all())


def _friction(observed: Observation, at: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the torque of a joint's friction and its s.d., (m,) each [Nm].

    At rest it opposes the last movement; before the first posture of a set-up nobody knows which that was. In
    a motion it opposes the rate, and damping is a part of it. The errors of servos scatter about that by the
    limit (in three simulated records by 0.95; about the rule for rest by 1.4, about nothing by 1.35).
    """
    m, model = observed.measurements, observed.nominal.robot.model
    (dof,) = model.joint(observed.tree.joints[at]).dofadr
    limit = float(model.dof_frictionloss[dof])
    mean, sd = np.zeros(len(observed)), np.full(len(observed), limit)
    if m.joint_rates is not None:
        rate = m.joint_rates[:, at]
        mean = -limit * np.sign(rate) - model.dof_damping[dof] * rate
    elif m.command is not None:
        for previous, row in successive(m):
            mean[row] = -OPPOSED * limit * np.sign(m.command[row, at] - m.command[previous, at])
            sd[row] = UNKNOWN * limit
    return mean, sd


_on_encoder = partial(Effect, targets=JOINTS)


EFFECTS = (
    _on_encoder(
        name="encoder-offset",
        sentence="A joint's encoder reads a constant angle too much.",
        parameters=(Parameter("offset", "rad", prior=np.radians(1.0)),),
        mechanism=added(ANGLES, lambda fault: fault.size * _joint(fault)),
        words="The {target} encoder reads {0} too high.",
        lasting=Lasting(until="zero"),
        explanation="A joint's encoder has a wrong zero: it was mounted or homed with a constant error.",
    ),
    _on_encoder(
        name="encoder-gain",
        sentence="A joint's encoder reads (1 + gain) times the joint's angle.",
        parameters=(Parameter("gain", "", prior=0.02),),
        mechanism=scaled(ANGLES, lambda fault: 1 + fault.size * _joint(fault)),
        words="The {target} encoder reads {0} of its angle too much.",
        explanation="""A joint's encoder reads a multiple of the joint's angle: the counts per turn or the
        disc are wrong.

        The angle is measured from the joint's zero, so postures near zero cannot show the effect.
        """,
    ),
    _on_encoder(
        name="encoder-wander",
        sentence="A joint's encoder has a zero that wanders slowly, about a mean of zero.",
        parameters=waves("rad", prior=np.radians(0.05)),
        mechanism=added(ANGLES, lambda fault: np.outer(wandering(fault), _joint(fault))),
        words="The zero of the {target} encoder wanders slowly: {0}, {1}, {2} and {3} of the waves of its "
        "path.",
        lasting=Lasting(until="session"),
        searched=False,
        explanation=WANDERING,
    ),
    _on_encoder(
        name="encoder-slip",
        sentence="A joint's encoder slips: from some time on it reads an angle too much.",
        parameters=(Parameter("slip", "rad", prior=np.radians(1.0)), Parameter("start", "", grid=STARTS)),
        mechanism=added(ANGLES, _slip),
        words="The {target} encoder slipped and reads {0} too high from {1} of the experiment's time on.",
        explanation="A joint's encoder slips on its shaft during the experiment and reads an angle too much "
        "from "
        "then on.",
    ),
    Effect(
        name="encoder-load",
        sentence="A joint's encoder reads too much in proportion to the vertical force on the foot of its "
        "leg.",
        parameters=(Parameter("rate", "rad/N", prior=np.radians(0.001)),),
        mechanism=added(ANGLES, _by_load),
        words="The {target} encoder reads {0} too high under the load of its leg.",
        targets=LEG_JOINTS,
        explanation="""A joint's encoder errs in proportion to the load on its leg, which shifts the shaft
        against the read head.

        reading = angle + rate times the vertical force on the foot below the joint. Any joint of a leg can
        have it, also one whose own torque is small. The size is assumed: a shift by 0.1 mm on a ring of 30 mm
        radius reads 0.2 degrees, here under the full weight of a robot of 23 kg.
        """,
    ),
    _on_encoder(
        name="lag",
        sentence="A joint's reading lags behind by a fraction of the last change of its angle.",
        parameters=(Parameter("part", "", prior=0.005),),
        mechanism=mapped(ANGLES, _lag, _without_lag),
        words="The reading of the {target} joint lags behind by {0} of the last change of its angle.",
        explanation="""A joint's reading lags: it keeps a part of the posture before, as behind a sluggish
        filter.

        reading = angle + part (previous angle - angle). The previous angle is that of the preceding row in
        the order of time, even if a posture was tried in between and dropped. Where the robot was set down
        again (another placement or support) it was carried for minutes in between, so the reading begins
        afresh, without lag.
        """,
    ),
    _on_encoder(
        name="logged-command",
        sentence="The log holds a joint's command in place of its encoder's reading.",
        parameters=(Parameter("source", "", grid=(1,), choices=SOURCES),),
        mechanism=Misreading(_log_command, _restore_angle, _off_friction),
        words="The log of the {target} joint holds its {0} in place of its encoder's reading.",
        explanation="""The log holds a joint's commanded angle in place of its encoder's reading.

        Such a log agrees with the command in all postures, up to rounding; a true reading does not, because a
        servo holds its load with an error. The prediction restores the angle where the motor's encoder says
        that the motor is. If motors were not recorded, it is where the nominal servo yields to the load of
        the nominal robot: torque = stiffness (command - angle), stiffness = torque limit over the error at
        full torque. Dry friction opposes the last movement: 0.8 of its limit is assumed, with an s.d. of 0.5
        in every posture; in a motion, all of it opposes the rate. In both cases the joint turns beyond its
        motor by the wind-up that the robot's description states.

        Where the log differs from the command the fault is absent. The prediction then adds it, which shows
        how much of it the experiment would see and explains nothing. Without commands in the measurements it
        changes nothing. There is no size to estimate; the one choice is what was logged.
        """,
    ),
)

"""The knowledge before a day of measurements: the robot, its tolerances, and the faults that may begin.

The residuals of a posture are linear in the state x = (base parameters less CAD's, error of the weight,
deviates of the ordinary imperfections, errors of readings that last, errors of the placement's recorded
plates, swing foot's place in the stance). Before the first row x is normal with mean zero.

Errors that last are those of a robot that moves: of each encoder and cell, and of the wrench between the feet
that no cell shows, an Ornstein-Uhlenbeck process each. Its inertias are those of the families.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.linalg import block_diag

from tulip_testbed.calibration.families import Family, families_in
from tulip_testbed.calibration.linear_model import weighed_precision
from tulip_testbed.calibration.linearisation import joint_compliance, mixing_of
from tulip_testbed.calibration.self_calibration import usual_tolerances
from tulip_testbed.effects.catalogue import catalogue, targets_in
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.identification.base_parameters import common_support, standard_parameters
from tulip_testbed.identification.cad_prior import cad_prior
from tulip_testbed.identification.contact_readings import margin_of_load
from tulip_testbed.identification.inertial_wrench import beyond_weight
from tulip_testbed.identification.noise_in_time import WHITE, NoiseInTime
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.residual_noise import ASSUMED_CELL, ASSUMED_ENCODER, Noise, noise_of
from tulip_testbed.measurements import MeasurementHeader, Measurements, PosturePlan
from tulip_testbed.measurements.cells import CELLS
from tulip_testbed.measurements.trajectory import Trajectory
from tulip_testbed.sim.plan_folder import check_fits
from tulip_testbed.sim.robot import Robot

MASS_SD = 0.25  # relative, of each link's mass by CAD
STANCE_SD = np.array([0.03, 0.03, 0.1])  # m, m, rad, of the swing foot about its planned place
PLATES, STANCE = 6, 3  # numbers of the state that begin anew with a placement or a stance
# Faults that can begin in the middle of a day; an effect with a start begins at once.
STEPS = (
    *("encoder-slip", "encoder-gain", "cell-gain", "cell-tare", "plate-drift", "thermal-gain-drift"),
    *("plate-translation", "plate-yaw", "tilt", "tether", "payload-step", "joint-compliance"),
    "sole-compliance",
)
RAMPS = ("cell-tare", "plate-drift", "thermal-gain-drift")  # these may also grow steadily
RAMP = 10.0  # postures in which a ramp grows by one plausible size
HIDDEN = 4  # components of the wrench between the feet that no cell shows, and a share of inertial forces


@dataclass(frozen=True, eq=False)
class DayModel:
    """A plan with everything that is known of its day before the first row.

    Attributes:
        plan: postures in their order.
        nominal: the robot by CAD.
        noise: of the readings, by the data sheets.
        families: of ordinary imperfections. mixing: members from their deviates, (q, k).
        covariance: of the state before the day, (n, n); plates and stance are the last nine.
        faults: that may begin, of one plausible size. growing: numbers of those that may also grow steadily.
        unseen: s.d. of joint compliances, (n_joints,) [rad/Nm].
        window: of a row of a motion [s]; None: the robot holds postures.
        noise_in_time: how the noise of rows is correlated; in postures it is not.
        inertias: directions of the inertial parameters that the planned motion shows, (10 n_links, k).
    """

    plan: PosturePlan
    nominal: Nominal
    noise: Noise
    families: tuple[Family, ...]
    mixing: np.ndarray
    covariance: np.ndarray
    faults: tuple[EffectInstance, ...]
    growing: list[int]
    unseen: np.ndarray
    window: float | None = None
    noise_in_time: NoiseInTime = WHITE
    inertias: np.ndarray | None = None

    @property
    def held(self) -> bool:
        """Return whether the robot holds postures; else it moves."""
        return self.window is None

    @property
    def unit(self) -> str:
        return "posture" if self.held else "row"

    @property
    def rows(self) -> int:
        """Count the rows of the day: postures, or windows of the planned motion."""
        if self.window is None or self.plan.motion is None:
            return len(self.plan)
        return max(1, round(self.plan.motion.seconds / self.window))

    @property
    def lasting(self) -> slice:
        """Return the numbers of the state that are errors that last."""
        last = len(self.covariance) - PLATES - STANCE
        count = 0 if self.held else len(self.unseen) + len(CELLS) + HIDDEN
        return slice(last - count, last)

    def kept(self, seconds: float) -> float:
        """Return the correlation of an error that lasts with itself after a time; NaN: in another segment."""
        return float(np.exp(-seconds / self.noise_in_time.seconds)) if seconds >= 0 else 0.0

    @cached_property
    def shares(self) -> tuple[float, float]:
        """Return the shares of a row's variance that last and that are new in every row."""
        if self.window is None:
            return 0.0, 1.0
        # Two rows apart by n windows have the correlation share exp(-n window / seconds).
        apart, lasts = 8 * self.window, self.noise_in_time.seconds
        share = float(self.noise_in_time.correlation(np.array([0.0, apart]), self.window)[0, 1])
        share = min(share * np.exp(apart / lasts), 1.0)
        return share, 1.0 - share

    @property
    def independent(self) -> float:
        """Return how many independent rows tell as much of a constant as a row whose noise lasts."""
        if self.window is None:
            return 1.0
        next_to = self.shares[0] * self.kept(self.window)
        return (1 - next_to) / (1 + next_to)

    def with_noise(self, noise_in_time: NoiseInTime) -> Self:
        """Return the model of a day whose noise is correlated in this way."""
        model = replace(self, noise_in_time=noise_in_time, covariance=self.covariance.copy())
        at = model.lasting
        model.covariance[at, at] = model.shares[0] * np.eye(at.stop - at.start)
        return model

    @property
    def parameters(self) -> int:
        return len(self.nominal.value)

    def first_rows(self, rows: Measurements) -> np.ndarray:
        """Return the plan's first row of each row's posture (of a motion: of its placement), (m,); else 0."""
        number = "posture" if self.held else "placement"
        return (getattr(self.plan, number) == getattr(rows, number)[:, None]).argmax(axis=1)

    @property
    def directions(self) -> tuple[EffectInstance, ...]:
        """Return the c directions of the residuals: faults that begin at once, then ramps."""
        return (*self.faults, *(self.faults[k] for k in self.growing))

    @property
    def ramps(self) -> np.ndarray:
        """Return which directions are ramps, which grow with every posture, (c,) bool."""
        return np.arange(len(self.directions)) >= len(self.faults)

    def observe(self, rows: Measurements) -> Observation:
        """Return an observation in which no row depends on another one.

        Time is counted in the plan's postures or a motion's rows, so that neither a break nor a clock that
        jumps matters. Servos sag where the plan has no feed-forward.
        """
        seen, first = observe(rows, self.nominal, self.inertias), self.first_rows(rows)
        time, fed = first / max(len(self.plan) - 1, 1), self.plan.feed_forward[first].any(axis=1)
        if (motion := self.plan.motion) is not None:
            time, fed = rows.posture / self.rows, np.full(len(rows), motion.torques is not None)
        forces = seen.cell_forces.reshape(len(seen), 2, 4)
        loaded = forces.min(axis=2) > margin_of_load(self.noise.cell) - seen.board_share
        return replace(
            seen,
            cell_sd=self.noise.cell,
            sag=np.where(fed, 0.0, 1.0),
            time_fraction=time,
            on_four_cells=loaded,
        )


def day_model(
    plan: PosturePlan, robot: Robot, header: MeasurementHeader, window: float | None = None
) -> DayModel:
    """Prepare the watch of a day on plates with four cells; a plan that moves has rows of a window [s]."""
    check_fits("plan", plan, robot)
    nominal = nominal_robot(robot, common_support(plan.support))
    observed, inertias = observe(Measurements.without_rows(header), nominal), None
    if window is not None:
        assert plan.motion is not None
        shown = beyond_weight(nominal, _planned_rows(header, plan.motion, window))
        observed, inertias = observed.changed(motion=shown), shown.directions
    sheet = header.sensors  # what it does not state is assumed: one row cannot tell it
    stated = replace(
        sheet, encoder_sd=sheet.encoder_sd or ASSUMED_ENCODER, cell_sd=sheet.cell_sd or ASSUMED_CELL
    )
    noise = noise_of(replace(observed, measurements=replace(observed.measurements, sensors=stated)))
    families = families_in(observed, usual_tolerances(observed, None))
    mixing, _ = mixing_of(families)
    sizes = np.concatenate([np.zeros(0), *(np.full(len(part), part.tolerance) for part in families)])
    faults = _faults(robot)
    base = cad_prior(nominal.parameters, standard_parameters(robot.model), MASS_SD).root
    prior = block_diag(
        base @ base.T,
        1 / weighed_precision(observed) ** 2,
        np.eye(mixing.shape[1]),
        np.eye(0 if window is None else len(observed.tree.joints) + len(CELLS) + HIDDEN),
        np.eye(PLATES),
        np.diag(STANCE_SD**2),
    )
    return DayModel(
        plan=plan,
        nominal=nominal,
        noise=noise,
        families=families,
        mixing=mixing,
        covariance=prior,
        faults=faults,
        # In the minutes of a motion nothing grows steadily.
        growing=[k for k, fault in enumerate(faults) if window is None and fault.effect.name in RAMPS],
        unseen=joint_compliance(families, sizes, observed.tree.joints),
        window=window,
        inertias=inertias,
    )


def _planned_rows(header: MeasurementHeader, motion: Trajectory, window: float) -> Measurements:
    """Return the planned motion as rows without readings, one a window."""
    rates, faster = np.zeros((2, *motion.joint_angles.shape))
    for rows in motion.segments:
        if rows.stop - rows.start > 2:
            rates[rows] = np.gradient(motion.joint_angles[rows], motion.time[rows], axis=0)
            faster[rows] = np.gradient(rates[rows], motion.time[rows], axis=0)
    seconds = max(motion.seconds, window)
    at = np.linspace(0, len(motion) - 1, max(2, round(seconds / window))).astype(int)
    return Measurements.from_arrays(
        header,
        posture=np.arange(len(at)),
        placement=motion.placement[at],
        support=motion.support[at],
        time=motion.time[at],
        window=np.full(len(at), window),
        joint_angles=motion.joint_angles[at],
        joint_rates=rates[at],
        joint_accelerations=faster[at],
        cell_forces=np.zeros((len(at), len(CELLS))),
        plate_poses=np.zeros((len(at), 2, 3)),
    )


def _faults(robot: Robot) -> tuple[EffectInstance, ...]:
    """List the faults that may begin, of plausible sizes in several directions; a start is the least."""
    faults = []
    for effect in map(catalogue().__getitem__, STEPS):
        plain = np.array([p.prior if k in effect.sizes else 0.0 for k, p in enumerate(effect.parameters)])
        signs = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]] if len(effect.sizes) > 1 else [1.0]
        sizes = [tuple((plain * sign).tolist()) for sign in signs]
        faults += [
            EffectInstance(effect, target, size)
            for target in targets_in(effect, robot, None, ())
            for size in sizes
        ]
    return tuple(faults)

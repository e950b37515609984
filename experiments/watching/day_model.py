"""The knowledge before a day of measurements: the robot, its tolerances, and the faults that may begin.

The residuals of a posture are linear in the state x = (base parameters less CAD's, error of the weight,
deviates of the ordinary imperfections, errors of the placement's recorded plates, swing foot's place in the
stance). Before the first row x is normal with mean zero.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from tulip_testbed.calibration.families import Family, families_in
from tulip_testbed.calibration.linear_model import weighed_precision
from tulip_testbed.calibration.linearisation import joint_compliance, mixing_of
from tulip_testbed.calibration.self_calibration import usual_tolerances
from tulip_testbed.effects.catalogue import catalogue, targets_in
from tulip_testbed.effects.effect import Effect
from tulip_testbed.effects.instance import effect_label
from tulip_testbed.identification.base_parameters import common_support, standard_parameters
from tulip_testbed.identification.cad_prior import cad_prior
from tulip_testbed.identification.nominal import Nominal, nominal_robot
from tulip_testbed.identification.observation import LEAST_LOAD, Observation, observe
from tulip_testbed.identification.residual_noise import ASSUMED_CELL, ASSUMED_ENCODER, Noise, noise_of
from tulip_testbed.measurements import MeasurementHeader, Measurements, PosturePlan
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


@dataclass(frozen=True)
class Direction:
    """One fault that may begin, as a direction in the space of the residuals.

    Attributes:
        effect, target: of the catalogue.
        sizes: values of the effect's parameters at one plausible size [SI].
        ramp: whether it grows with every posture instead of beginning at once.
    """

    effect: Effect
    target: str
    sizes: tuple[float, ...]
    ramp: bool

    @property
    def label(self) -> str:
        return effect_label(self.effect.name, self.target)

    def words(self, size: float) -> str:
        """Tell the change in words.

        Args:
            size: in plausible sizes; of a ramp, in ten postures.
        """
        parameters = self.effect.parameters_on(self.target)
        values = [parameters[k].text(size * self.sizes[k]) for k in self.effect.sizes if self.sizes[k]]
        sort = "drifts by about {} in ten postures" if self.ramp else "changed by about {}"
        return f"{self.label}: {sort.format(', '.join(values))}"


@dataclass(frozen=True, eq=False)
class DayModel:
    """A plan with everything that is known of its day before the first row.

    Attributes:
        plan: postures in their order.
        nominal: the robot by CAD.
        noise: of the readings, by the data sheets.
        families: of ordinary imperfections. mixing: members from their deviates, (q, k).
        covariance: of the state before the day, (n, n); plates and stance are the last nine.
        directions: faults that may begin. unseen: s.d. of joint compliances, (n_joints,) [rad/Nm].
    """

    plan: PosturePlan
    nominal: Nominal
    noise: Noise
    families: tuple[Family, ...]
    mixing: np.ndarray
    covariance: np.ndarray
    directions: tuple[Direction, ...]
    unseen: np.ndarray

    @property
    def parameters(self) -> int:
        """Count the base parameters."""
        return len(self.nominal.value)

    def first_rows(self, rows: Measurements) -> np.ndarray:
        """Return the plan's first row of the posture of each measured row, (m,); 0 if it has none."""
        return (self.plan.posture == rows.posture[:, None]).argmax(axis=1)

    @cached_property
    def ramps(self) -> np.ndarray:
        """Return which directions are ramps, (c,) bool."""
        return np.array([direction.ramp for direction in self.directions])

    def observe(self, rows: Measurements) -> Observation:
        """Return an observation in which no row depends on another one.

        Time is counted in the plan's postures, so that neither a break nor a clock that jumps matters. Servos
        sag where the plan has no feed-forward.
        """
        seen, first = observe(rows, self.nominal), self.first_rows(rows)
        forces = seen.cell_forces.reshape(len(seen), 2, 4)
        margin = max(LEAST_LOAD, 4 * self.noise.cell)
        loaded = forces.min(axis=2) > margin - seen.board_share
        return replace(
            seen,
            cell_sd=self.noise.cell,
            sag=np.where(self.plan.feed_forward[first].any(axis=1), 0.0, 1.0),
            time_fraction=first / max(len(self.plan) - 1, 1),
            on_four_cells=loaded,
        )


def day_model(plan: PosturePlan, robot: Robot, header: MeasurementHeader) -> DayModel:
    """Prepare the watch of a day.

    Args:
        header: of the day's measurements, by plates on four cells.
    """
    check_fits("plan", plan, robot)
    nominal = nominal_robot(robot, common_support(plan.support))
    observed = observe(Measurements.without_rows(header), nominal)
    sheet = header.sensors  # what it does not state is assumed: one row cannot tell it
    stated = replace(
        sheet, encoder_sd=sheet.encoder_sd or ASSUMED_ENCODER, cell_sd=sheet.cell_sd or ASSUMED_CELL
    )
    noise = noise_of(replace(observed, measurements=replace(observed.measurements, sensors=stated)))
    families = families_in(observed, usual_tolerances(observed, None))
    mixing, _ = mixing_of(families)
    sizes = np.concatenate([np.zeros(0), *(np.full(len(part), part.tolerance) for part in families)])
    base = cad_prior(nominal.parameters, standard_parameters(robot.model), MASS_SD).root
    prior = block_diag(
        base @ base.T,
        1 / weighed_precision(observed) ** 2,
        np.eye(mixing.shape[1]),
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
        directions=_directions(robot),
        unseen=joint_compliance(families, sizes, observed.tree.joints),
    )


def _directions(robot: Robot) -> tuple[Direction, ...]:
    return tuple(
        Direction(effect, target, sizes, ramp)
        for effect in map(catalogue().__getitem__, STEPS)
        for target in targets_in(effect, robot, None, ())
        for ramp in ((False, True) if effect.name in RAMPS else (False,))
        for sizes in _sizes(effect)
    )


def _sizes(effect: Effect) -> list[tuple[float, ...]]:
    """Return plausible sizes of an effect in several directions; a start is the least that there is."""
    plain = np.array([p.prior if k in effect.sizes else 0.0 for k, p in enumerate(effect.parameters)])
    if len(effect.sizes) == 1:
        return [tuple(plain.tolist())]
    signs = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    return [tuple((plain * sign).tolist()) for sign in signs]

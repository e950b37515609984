"""The stacked regressor and output (eq. 7)."""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from tulip_testbed.base.errors import InputError, listed
from tulip_testbed.identification.base_parameters import BaseParameters, standard_parameters
from tulip_testbed.identification.cad_prior import cad_prior
from tulip_testbed.identification.center_of_pressure import center_slopes, contact_pressure, wrench_noise
from tulip_testbed.identification.loop_closure import encoder_sd_by_closure
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import Observation, observe
from tulip_testbed.identification.rank import undetermined_directions
from tulip_testbed.identification.reading_noise import cell_noise, placement_levers
from tulip_testbed.identification.residual_channels import by_weight, fields, sensitivity
from tulip_testbed.measurements import Measurements, SensorSheet
from tulip_testbed.measurements.data import feet_in_contact
from tulip_testbed.sim.plan_folder import check_model
from tulip_testbed.sim.robot import Robot

ROWS_OF = {  # supports of rows that a set of base parameters describes
    "double": ("double",),
    "right": ("double", "right"),
    "mixed": ("double", "right", "left"),
    "double-left": ("double", "left"),
}
ENCODER_SD = 5e-4  # rad, assumed without a data sheet

SINGLE = 2  # base parameters, or sums of them, that a single posture determines
SINGULAR = 1e-9  # relative, of columns by zeros
NOT_LEVEL = 1e-4  # relative: the square of a tilt of half a degree


@dataclass(frozen=True)
class Regression:
    """Linear regression y = H theta with two rows per posture (x, then y).

    Attributes:
        matrix: H, (2m, p) [-].
        output: y, (2m,) [m].
        numbers: numbers of the parameters in the full model, (p,).
        names: names of the parameters.
        placement: placement of each posture, (m,).
        load_share: share of the weight on the right and left plate, (m, 2).
        blur: error of H by the encoders' errors, B of `encoder_blur`, (k, p); None: angles are exact.
        source: source of the measurements, for error messages.
        slope: derivative of H by every joint angle, (m, 2, n_joints, p) [1/rad]; None: angles are exact.
        known_slope: derivative of minus the output by every joint angle, (m, 2, n_joints) [m/rad]: in rows on
            the swing foot the known lengths give the stance foot's place; None: there are none.
        encoder_sd: s.d. of the encoders' errors, by the closed chain if possible, else by the data sheet
            [rad]; None: unknown.
        cells: covariance of a posture's centre of pressure for cells with an s.d. of 1 N, (m, 2, 2)
            [m2/N2]; None: the same in all postures and axes.
        levers: see `placement_levers`, (m, 2, 6) [-, -, m]; None: by the load share, without yaw.
        sensors: data-sheet figures.
        parameters, robot, mass: base parameters, robot and total mass with its s.d. [kg], for estimators
            with prior knowledge; None: unknown. observed: the experiment; None: unknown.
    """

    matrix: np.ndarray
    output: np.ndarray
    numbers: np.ndarray
    names: tuple[str, ...]
    placement: np.ndarray
    load_share: np.ndarray
    blur: np.ndarray | None = None
    source: str = "measurements"
    slope: np.ndarray | None = None
    known_slope: np.ndarray | None = None
    encoder_sd: float | None = None
    cells: np.ndarray | None = None
    levers: np.ndarray | None = None
    sensors: SensorSheet = field(default_factory=SensorSheet)
    parameters: BaseParameters | None = None
    robot: Robot | None = None
    mass: tuple[float, float] | None = None
    observed: Observation | None = None

    def keep(self, numbers: list[int]) -> Self:
        """Return the simplified model, which keeps these parameters and sets the others to zero."""
        if unknown := set(numbers) - set(self.numbers.tolist()):
            raise InputError(
                f"simplified model: unknown parameter numbers {listed(sorted(unknown))}; "
                f"valid: 1 to {len(self.numbers)}"
            )
        chosen = np.flatnonzero(np.isin(self.numbers, numbers))
        return replace(
            self,
            matrix=self.matrix[:, chosen],
            blur=None if self.blur is None else self.blur[:, chosen],
            slope=None if self.slope is None else self.slope[..., chosen],
            numbers=self.numbers[chosen],
            names=tuple(self.names[i] for i in chosen),
        )


def stacked_regressor(
    parameters: BaseParameters, joint_angles: np.ndarray, support: np.ndarray | None = None
) -> np.ndarray:
    """Compute H of eq. 7 for joint angles (m, n_joints) [rad] and supports as in `regressor`, (2m, p)."""
    return parameters.regressor(joint_angles, support).reshape(-1, len(parameters.names))


def encoder_blur(
    parameters: BaseParameters, joint_angles: np.ndarray, sd: float, support: np.ndarray | None = None
) -> np.ndarray:
    """Compute the error of H by one s.d. [rad] of every encoder, condensed to (p, p).

    It is B with B'B = sum over joints of sd^2 (dH/dq)' (dH/dq); see `BaseParameters.regressor` for the rows.
    """
    return _blur(parameters.slope(joint_angles, support), sd)


def _blur(slope: np.ndarray, sd: float) -> np.ndarray:
    return np.asarray(np.linalg.qr(sd * slope.reshape(-1, slope.shape[-1]), mode="r"))


def check_robot(
    parameters: BaseParameters, measurements: Measurements, robot: Robot, source: str = "measurements"
) -> None:
    where = f"{source}: manifest.json"
    check_model(where, measurements.robot["model"], measurements.robot["sha256"], robot)
    for key, expected in (("stance_foot", robot.stance_foot), ("swing_foot", robot.swing_foot)):
        if measurements.robot[key] != expected:
            raise InputError(
                f"{where}: key 'robot.{key}': found '{measurements.robot[key]}', expected '{expected}'"
            )
    _check_joints(f"{where}: key 'joints'", measurements.joints, parameters.tree.joints)


def with_cad_where_needed(observed: Observation, data: Regression) -> Observation:
    """Return the observation with CAD as prior if its postures do not determine all base parameters.

    Those of a moving record, which follow each other, may determine them by their noise alone, and so may any
    the weight.

    Raises:
        InputError: they determine no more than a single posture does.
    """
    few, free = len(data.matrix) <= data.matrix.shape[1], undetermined_directions(data.matrix, data.blur)
    by_noise = (observed.moves and observed.in_feet) or _of_unknown_weight(observed)
    if not few and not len(free) and not by_noise:
        return observed
    known = data.matrix.shape[1] - len(free)
    if known <= SINGLE:
        raise InputError(
            f"{data.source}: the postures determine {known} of {len(data.names)} parameters, no more than a "
            "single posture does, expected joints that move"
        )
    nominal = observed.nominal
    return replace(observed, cad=cad_prior(nominal.parameters, standard_parameters(nominal.robot.model)))


def _of_unknown_weight(observed: Observation) -> bool:
    """Return whether nothing shows the weight: no scale, and no row whose sensors' zeros are known.

    Moments then show only the base parameters times the weight.
    """
    contacts, m = observed.contacts, observed.measurements
    if m.weighed_mass is not None or m.contacts is None or contacts.unknown is None:
        return False
    sure = ~contacts.unknown[:, m.contacts.channels.index("fz")]
    return not (sure | ~feet_in_contact(m.support)).all(axis=1).any()


def _check_joints(where: str, found: tuple[str, ...], expected: tuple[str, ...]) -> None:
    """Refuse joints other than the robot's; names those that make the difference."""
    if missing := [joint for joint in expected if joint not in found]:
        others = [joint for joint in found if joint not in expected]
        strange = f"; found {listed(others)}, which the robot does not have" if others else ""
        raise InputError(f"{where}: missing: {listed(missing)}{strange}")
    if found != expected:
        raise InputError(f"{where}: found {listed(found)}; expected the model's order {listed(expected)}")


def regression(
    parameters: BaseParameters, measurements: Measurements, robot: Robot, source: str = "measurements"
) -> Regression:
    """Stack measured joint angles and centres of pressure into a regression."""
    check_robot(parameters, measurements, robot, source)
    served = ROWS_OF[parameters.support]
    if (other := ~np.isin(measurements.support, served)).any():
        row = int(np.flatnonzero(other)[0])
        raise InputError(
            f"{source}: postures, column 'support', row {row + 1}: found '{measurements.support[row]}', "
            f"expected {' or '.join(map(repr, served))} (base parameters in {parameters.support} support)"
        )
    sheet = measurements.sensors
    angles, support = measurements.joint_angles, measurements.support
    slope = parameters.slope(angles, support)
    tree, swing = parameters.tree, parameters.tree.frame(robot.swing_foot)
    both = support == "double"
    by_closure = encoder_sd_by_closure(
        tree, parameters.base, swing, angles[both], measurements.placement[both]
    )
    matrix = stacked_regressor(parameters, angles, support)
    nominal = nominal_robot(robot, parameters.support)
    if parameters.tree is not nominal.parameters.tree:
        nominal = replace(nominal, parameters=parameters)
    observed = observe(measurements, nominal)
    pressure = contact_pressure(observed)
    output, known_slope = pressure.center, None
    if observed.moves:
        faster = observed.motion.slope[:, :2]
        matrix, output = matrix + faster.reshape(matrix.shape), output + faster @ nominal.value
    if parameters.on_swing_foot(support).any():
        known = nominal.geometry(angles, support)
        output, known_slope = output - known.stance_sole[:, :2], known.stance_sole_slope[:, :2]
    fitted = (matrix @ np.linalg.lstsq(matrix, output.ravel(), rcond=None)[0]).reshape(-1, 2)
    fitted += pressure.center - output
    if measurements.contacts is None:
        cells, levers = cell_noise(measurements, fitted), placement_levers(measurements)
    else:
        by = center_slopes(observed)
        cells, levers = wrench_noise(observed, by["cells"], fitted), by["plates"]
        sheet = replace(sheet, cell_sd=1.0)  # readings are scaled to it
        if observed.in_feet:  # the left sensor's place moves with the angles too
            known_slope = -by["angles"] - slope @ nominal.value
    return Regression(
        matrix=matrix,
        blur=_blur(slope, ENCODER_SD if sheet.encoder_sd is None else sheet.encoder_sd),
        source=source,
        output=output.ravel(),
        numbers=np.arange(1, len(parameters.names) + 1),
        names=parameters.names,
        placement=measurements.placement,
        load_share=pressure.load_share,
        slope=slope,
        known_slope=known_slope,
        encoder_sd=sheet.encoder_sd or None if by_closure is None else by_closure,
        cells=cells,
        levers=levers,
        sensors=sheet,
        parameters=parameters,
        robot=robot,
        mass=measurements.weighed_mass or pressure.mass,
        observed=observed,
    )


def zero_columns(observed: Observation) -> np.ndarray:
    """Return how zeros of which nothing is known change centre of pressure and weight, (m, 3, z).

    There is a column for every channel whose zero was neither stated nor shown by feet in the air.
    """
    readings = observed.contacts
    if readings.unknown is None or readings.by_channel is None:
        return np.zeros((len(observed), 3, 0))
    k, by_channel = len(readings.by_channel), readings.by_channel
    by_reading = sensitivity(observed, observed.nominal.value)[:, :3, fields(observed)["cells"]]
    sides = [by_reading[..., k * s : k * (s + 1)] @ by_channel[:, readings.unknown[s]] for s in (0, 1)]
    return np.concatenate(sides, axis=2)


def confounded_directions(observed: Observation, data: Regression) -> np.ndarray:
    """Return a basis of the directions that the zeros imitate, (d, p); d = 0 without unknown zeros.

    They are those that the regressor does not determine once the zeros' columns, in the centre of pressure
    and in the sum of the forces, are projected out.
    """
    m, p = len(observed), data.matrix.shape[1]
    columns = zero_columns(observed)
    if not columns.shape[2]:
        return np.zeros((0, p))
    if observed.measurements.weighed_mass is None:  # the weight is unknown too
        columns = np.concatenate([columns, by_weight(observed)[:, :3, None]], axis=2)
    columns[:, 2] /= observed.weight
    whole = np.concatenate([data.matrix.reshape(m, 2, p), np.zeros((m, 1, p))], axis=1).reshape(-1, p)
    basis, size, _ = np.linalg.svd(columns.reshape(3 * m, -1), full_matrices=False)
    basis = basis[:, size > SINGULAR * size[0]]
    # What is left of a column that was projected out because a measured sole is not quite level.
    left = np.diag(NOT_LEVEL * np.linalg.norm(whole, axis=0))
    blur = left if data.blur is None else np.vstack([data.blur, left])
    return undetermined_directions(whole - basis @ (basis.T @ whole), blur)

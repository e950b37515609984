"""The stacked regressor and output (eq. 7)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identification.base_parameters import BaseParameters
from identification.center_of_pressure import center_of_pressure, load_shares
from sim.errors import InputError, listed
from sim.measurements import Measurements
from sim.measurements.plan_folder import check_model
from sim.model import Robot

ENCODER_SD = 5e-4  # rad, where no data sheet tells
DERIVATIVE_STEP = 1e-4  # rad


@dataclass(frozen=True)
class Regression:
    """y = H theta, two rows a posture (x, then y).

    Attributes:
        matrix: H, (2m, p) [-].
        output: y, (2m,) [m].
        numbers: the parameters' numbers in the full model, (p,).
        names: their names.
        placement: placement of each posture, (m,).
        load_share: share of the weight on the right and left plate, (m, 2).
        blur: what the encoders' errors may make of H: B with B'B of `encoder_blur`, (k, p); None
            where angles are exact.
        source: where the measurements came from, for error messages.
    """

    matrix: np.ndarray
    output: np.ndarray
    numbers: np.ndarray
    names: tuple[str, ...]
    placement: np.ndarray
    load_share: np.ndarray
    blur: np.ndarray | None = None
    source: str = "measurements"

    def keep(self, numbers: list[int]) -> Regression:
        """The simplified model that keeps these parameters and sets the others to zero.

        Raises:
            InputError: a number that the full model does not have.
        """
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
            numbers=self.numbers[chosen],
            names=tuple(self.names[i] for i in chosen),
        )


def stacked_regressor(parameters: BaseParameters, joint_angles: np.ndarray) -> np.ndarray:
    """H of eq. 7 for joint angles (m, n_joints) [rad]: (2m, p)."""
    return parameters.regressor(joint_angles).reshape(-1, len(parameters.names))


def encoder_blur(parameters: BaseParameters, joint_angles: np.ndarray, sd: float) -> np.ndarray:
    """One s.d. of every encoder times the derivative of H by its angle, condensed to (p, p).

    Args:
        joint_angles: (m, n_joints) [rad].
        sd: of the encoders' errors [rad].

    Returns:
        B with B'B = sum over joints of sd^2 (dH/dq)' (dH/dq).
    """
    total = np.zeros((0, len(parameters.names)))
    for step in DERIVATIVE_STEP * np.eye(joint_angles.shape[1]):
        ahead, behind = (stacked_regressor(parameters, joint_angles + s) for s in (step, -step))
        derivative = (ahead - behind) / (2 * DERIVATIVE_STEP)
        total = np.asarray(np.linalg.qr(np.vstack([total, sd * derivative]), mode="r"))
    return total


def regression(
    parameters: BaseParameters, measurements: Measurements, robot: Robot, source: str = "measurements"
) -> Regression:
    """Stack measured joint angles and centres of pressure.

    Args:
        source: where the measurements came from, for error messages.

    Raises:
        InputError: another model than the measurements were made with, other joints or feet,
            another support, or fewer data points than parameters.
    """
    where = f"{source}: manifest.json"
    check_model(where, measurements.robot["model"], measurements.robot["sha256"], robot)
    for key, expected in (("stance_foot", robot.stance_foot), ("swing_foot", robot.swing_foot)):
        if measurements.robot[key] != expected:
            raise InputError(
                f"{where}: key 'robot.{key}': found '{measurements.robot[key]}', expected '{expected}'"
            )
    if measurements.joints != parameters.tree.joints:
        raise InputError(
            f"{where}: key 'joints': found {listed(measurements.joints)}; "
            f"expected the model's order {listed(parameters.tree.joints)}"
        )
    if (other := measurements.support != "double").any():
        row = int(np.flatnonzero(other)[0])
        raise InputError(
            f"{source}: postures, column 'support', row {row + 1}: found '{measurements.support[row]}', "
            "expected 'double' (the only support that can be identified so far)"
        )
    rows, columns = 2 * len(measurements), len(parameters.names)
    if rows <= columns:
        raise InputError(
            f"{source}: found {len(measurements)} postures ({rows} data points), expected at least "
            f"{columns // 2 + 1} for {columns} base parameters"
        )
    sd = measurements.sensors.encoder_sd
    return Regression(
        matrix=stacked_regressor(parameters, measurements.joint_angles),
        blur=encoder_blur(parameters, measurements.joint_angles, ENCODER_SD if sd is None else sd),
        source=source,
        output=center_of_pressure(measurements).ravel(),
        numbers=np.arange(1, columns + 1),
        names=parameters.names,
        placement=measurements.placement,
        load_share=load_shares(measurements),
    )

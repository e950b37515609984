"""A synthetic laboratory: the regressor of the true angles, and drawn errors. No physics, so it is fast."""

import dataclasses

import numpy as np

from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.regressor import Regression, encoder_blur, stacked_regressor
from tulip_testbed.measurements import PosturePlan, SensorSheet

# S.d. of cells [N], of the left and the right plate's positions [m], of encoders [rad]; much like preset wii.
WII = {"cell": 1.4, "placement": 3.5e-3, "mark": 1e-3, "encoder": 4e-4}


@dataclasses.dataclass(frozen=True)
class Bench:
    """Postures and what of their errors' shape is fixed.

    Attributes:
        nominal: the true robot.
        angles: true joint angles, (m, n) [rad].
        placement: (m,), from 0.
        share: load shares of the right and left plate, (m, 2).
        cells: covariance of the CoP for cells with an s.d. of 1 N, (m, 2, 2) [m2/N2].
    """

    nominal: Nominal
    angles: np.ndarray
    placement: np.ndarray
    share: np.ndarray
    cells: np.ndarray

    def draw(
        self,
        rng: np.random.Generator,
        cell: float,
        placement: float,
        mark: float,
        encoder: float,
        sheet: float = 1.0,
    ) -> Regression:
        """One experiment; the data sheet states `sheet` times the true s.d."""
        parameters, count = self.nominal.parameters, len(self.angles)
        measured = self.angles + encoder * rng.standard_normal(self.angles.shape)
        output = parameters.regressor(self.angles) @ self.nominal.value
        output = output + cell * np.einsum(
            "mab,mb->ma", np.linalg.cholesky(self.cells), rng.standard_normal((count, 2))
        )
        groups = self.placement.max() + 1
        for plate, sd in enumerate((mark, placement)):
            output = (
                output + self.share[:, plate, None] * (sd * rng.standard_normal((groups, 2)))[self.placement]
            )
        levers = np.zeros((count, 2, 6))
        for plate in (0, 1):
            levers[:, 0, 3 * plate] = levers[:, 1, 3 * plate + 1] = self.share[:, plate]
        stated = sheet * placement
        return Regression(
            matrix=stacked_regressor(parameters, measured),
            output=output.ravel(),
            numbers=np.arange(1, 26),
            names=parameters.names,
            placement=self.placement,
            load_share=self.share,
            blur=encoder_blur(parameters, measured, 4e-4),
            slope=parameters.slope(measured),
            encoder_sd=encoder,
            cells=self.cells,
            levers=levers,
            sensors=SensorSheet(sheet * encoder, 0.0, sheet * cell, 0.0, (stated, stated, 3 * stated)),
            parameters=parameters,
            robot=self.nominal.robot,
            mass=(self.nominal.mass, 0.01),
        )


def synthetic_bench(nominal: Nominal, plan: PosturePlan) -> Bench:
    rng = np.random.default_rng(120)
    left = rng.uniform(0.3, 0.7, len(plan))
    root = 2e-3 * (np.eye(2) + 0.3 * rng.standard_normal((len(plan), 2, 2)))
    _, placement = np.unique(plan.placement, return_inverse=True)
    return Bench(nominal, plan.joint_angles, placement, np.column_stack([1 - left, left]), root @ root.mT)

"""How clearly an experiment shows a fault, and how far the fault moves the base parameters.

Both follow from the laboratory's own simulation and from linear least squares, in which ordinary members
have their tolerances as prior s.d. No estimator and no verdict of the package takes part, so that the cases
of the study stay the same when those change.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from studies.hidden_effects.laboratories import USUAL, Built, tolerance_of
from tulip_testbed.base.errors import InputError
from tulip_testbed.effects.catalogue import catalogue, targets_in
from tulip_testbed.effects.instance import effect_label
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import (
    by_weight,
    constants_of_stances,
    residuals,
    residuals_in_use,
)
from tulip_testbed.measurements import PosturePlan

STEP = 1e-4  # of readings, in SI units
FREE = 1e-9  # precision of columns without a prior, of length 1
LEAST_STANDING = 0.75  # of the postures


class Clearness:
    """A laboratory's experiment as a linear model.

    Attributes:
        built, plan: the experiment. plain: the laboratory without imperfections, for exact simulations.
    """

    def __init__(self, built: Built, plan: PosturePlan, seed: int):
        self.built, self.plan = built, plan
        tilt = {label: values for label, values in built.effects.items() if label == "tilt"}
        self.plain = replace(built, effects=tilt, noise=())
        measured = built.measured(plan, seed)
        self.nominal, self.postures = nominal_robot(built.rig.robot), measured.posture.tolist()
        observed, theta, sheet = observe(measured, self.nominal), self.nominal.value, measured.sensors
        self.used = residuals_in_use(observed)
        here = residuals(observed, theta)

        def change(name: str, size: float, *at: int) -> np.ndarray:
            values = getattr(observed, name).copy()
            values[:, *at] += STEP
            return (residuals(observed.changed(**{name: values}), theta) - here) * (size / STEP)

        joints, cells = observed.joint_angles.shape[1], observed.cell_forces.shape[1]
        own = [change("joint_angles", sheet.encoder_sd or 0.0, j) for j in range(joints)]
        own += [change("cell_forces", sheet.cell_sd or 0.0, c) for c in range(cells)]
        noise = np.where(self.used[..., None], np.stack(own, axis=2), 0.0)
        unused = ~self.used[..., None] * np.eye(self.used.shape[1])
        self.white = np.linalg.inv(np.linalg.cholesky(noise @ noise.mT + unused))
        of_base = np.stack([residuals(observed, theta + unit) - here for unit in np.eye(len(theta))], axis=2)
        poses = np.array([built.rig.sensors.mark_sd, built.rig.sensors.placement_sd])
        plates = np.stack([change("plate_poses", poses[at], *at) for at in np.ndindex(2, 3)], axis=2)
        place = measured.placement[:, None] == np.unique(measured.placement)
        weight = np.zeros((*here.shape, 1))
        weight[:, :3, 0] = by_weight(observed) * measured.gravity * built.rig.sensors.weighed_mass_sd
        members, self.owners = [], []
        for name in USUAL:
            effect, size = catalogue()[name], tolerance_of(name, built.preset)
            for target in targets_in(effect, built.rig.robot, None, ()):
                for unit in np.eye(len(effect.parameters)):
                    without = effect.remove(observed, target, tuple(size * unit))
                    members.append(here - residuals(without, theta))
                    self.owners.append(effect_label(name, target))

        def by_place(columns: np.ndarray) -> np.ndarray:
            return np.einsum("mck,mp->mckp", columns, place).reshape(*here.shape, -1)

        constants = by_place(constants_of_stances(self.used))
        known = [by_place(plates), weight, np.stack(members, axis=2)]
        self.columns = self._project(np.concatenate([of_base, constants, *known], axis=2))
        self.parameters, free = len(theta), len(theta) + constants.shape[2]
        self.columns[:, :free] /= np.maximum(np.linalg.norm(self.columns[:, :free], axis=0), 1e-300)
        self.prior = np.where(np.arange(self.columns.shape[1]) < free, FREE, 1.0)
        self.level = self._exact(self.plain)

    def _project(self, columns: np.ndarray) -> np.ndarray:
        """Whiten changes of the residuals, (m, 11, k) -> (11 m, k)."""
        return (self.white @ np.where(self.used[..., None], columns, 0.0)).reshape(-1, columns.shape[2])

    def _exact(self, built: Built) -> dict[int, np.ndarray]:
        """Simulate the residuals of every posture without noise."""
        measured = built.measured(self.plan, 0, exact=True)
        left = residuals(observe(measured, self.nominal), self.nominal.value)
        return dict(zip(measured.posture.tolist(), left, strict=True))

    def of(self, faulty: Built) -> tuple[float, float]:
        """Return by how many s.e. a fault shows, and the most by which it moves a base parameter.

        Args:
            faulty: `plain` with the fault. An ordinary member of its label has no prior.

        Raises:
            InputError: with the fault the robot falls in many postures.
        """
        changed = self._exact(faulty)
        stands = np.array([posture in changed and posture in self.level for posture in self.postures])
        if stands.mean() < LEAST_STANDING:
            raise InputError(f"the robot falls in {(~stands).sum()} of {len(stands)} postures")
        signal = np.zeros((*self.used.shape, 1))
        signal[stands, :, 0] = [changed[p] - self.level[p] for p in np.array(self.postures)[stands].tolist()]
        (white,) = self._project(signal).T
        own = {k for k, v in faulty.effects.items() if self.plain.effects.get(k) != v}
        kept = np.append(
            np.ones(len(self.prior) - len(self.owners), bool), [k not in own for k in self.owners]
        )
        columns = self.columns[:, kept]
        factor = cho_factor(columns.T @ columns + np.diag(self.prior[kept]))
        moved = cho_solve(factor, columns.T @ white)
        errors = np.sqrt(np.diag(cho_solve(factor, np.eye(len(moved)))))
        left = white @ white - (columns.T @ white) @ moved
        return float(np.sqrt(max(left, 0.0))), float(np.abs(moved / errors)[: self.parameters].max())

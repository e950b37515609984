"""The inertias that a motion determines, as a change of CAD's pseudo-inertias."""

from __future__ import annotations

import numpy as np

from tulip_testbed.effects.motion_effects import INERTIA
from tulip_testbed.experiments.identification_result import Identification

MOST = 0.9  # of the way from a link's inertia to that of a flat body: as far as data may change it


def with_identified_inertias(
    reference: np.ndarray, identification: Identification, links: tuple[str, ...]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return CAD's pseudo-inertias with what a motion determines of them, and a note.

    The change leaves base parameters and total mass as they are. If a link would not be physically consistent
    with it, the whole change is made smaller.

    Args:
        reference: CAD's, (n_links, 4, 4), positive definite; zero for a link without mass.
    """
    calibration = identification.calibration
    found = [] if calibration is None else calibration.families
    found = [one for one in found if one.family.effect.name == INERTIA.name]
    if calibration is None or not found:
        return reference, ()
    if calibration.observed is None:
        return reference, (
            "Inertias follow CAD. Export the measurement folder for what the motion determines.",
        )
    (one,) = found
    known, count = one.determined, len(one.value)
    numbers = np.array([int(target) - 1 for target in one.family.targets])
    directions = calibration.observed.motion.directions[:, numbers[known]]
    heavy = np.flatnonzero(reference[:, 3, 3] > 0)
    change = pseudo_change((directions @ one.value[known]).reshape(-1, 10))[heavy]
    inverse = np.linalg.inv(np.linalg.cholesky(reference[heavy]))
    sizes = np.linalg.eigvalsh(inverse @ change @ inverse.mT)
    share = min(1.0, MOST / max(float(-sizes.min()), MOST))
    out = reference.copy()
    out[heavy] += share * change
    most = np.abs(sizes).max(axis=1)
    note = f"The motion determines {known.sum()} of {count} directions of the inertial parameters"
    if known.any():
        link, size = links[heavy[most.argmax()]], 100 * share * most.max()
        note += f"; they change the inertia of {link} by up to {size:.2g} %, that of other links by less"
    if share < 1:
        note += f". A consistent robot can have {100 * share:.0f} % of this change"
    return out, (f"{note}.",)


def pseudo_change(change: np.ndarray) -> np.ndarray:
    """Return the change of pseudo-inertias by that of `inertial_parameters`, (n, 10) -> (n, 4, 4)."""
    out = np.zeros((len(change), 4, 4))
    xx, xy, yy, xz, yz, zz = change[:, 4:].T
    inertia = np.moveaxis(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), 2, 0)
    out[:, :3, :3] = np.trace(inertia, axis1=1, axis2=2)[:, None, None] / 2 * np.eye(3) - inertia
    out[:, :3, 3] = out[:, 3, :3] = change[:, 1:4]
    out[:, 3, 3] = change[:, 0]
    return out

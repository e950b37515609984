"""Write the identified robot as a model file: consistent, checked, and otherwise the user's own file."""

import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from scipy.linalg import block_diag

from tulip_testbed.base.errors import InputError, listed, shortened, warn
from tulip_testbed.base.files import check_new, present, read_bytes, write_bytes
from tulip_testbed.effects.instance import EffectInstance
from tulip_testbed.effects.motion_effects import INERTIA
from tulip_testbed.experiments.export.exported_model import ExportedModel, TotalMass, exported_links
from tulip_testbed.experiments.export.model_text import with_inertias, written_urdf
from tulip_testbed.experiments.export.published_links import PublishedLinks
from tulip_testbed.experiments.identification_result import Identification
from tulip_testbed.experiments.robot_import.skeleton import LEAST_MASS
from tulip_testbed.experiments.robot_import.urdf import find_mesh
from tulip_testbed.identification import pseudo_inertia
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters
from tulip_testbed.identification.cad_prior import cad_prior, expected_standard
from tulip_testbed.identification.consistent_robot import (
    ConsistentRobot,
    Target,
    consistent_robot,
    data_shares,
)
from tulip_testbed.identification.distributions import chi2_sf
from tulip_testbed.sim.mjcf_files import mjcf_files
from tulip_testbed.sim.robot import Robot, check_unchanged, load_spec, rotation_matrices

ENDINGS = (".xml", ".urdf")
EXACT = 1e-9  # m: how far the base parameters of the file may be from the stated ones
ALIKE = 1e-6  # of a pseudo-inertia, in its own metric
MOST = 0.9  # of the way from a link's inertia to that of a flat body: as far as data may change it
LEVEL = 1e-3  # of chi-square: estimate and CAD that are farther apart contradict each other


def export_model(
    identification: Identification,
    robot: Robot,
    path: Path,
    source: Path | None = None,
    adopted: Sequence[EffectInstance] = (),
    weighed: tuple[float, float] | None = None,
) -> ExportedModel:
    """Write the identified robot; see `tulip_testbed.export_model`.

    Args:
        adopted: effects that the laboratory is known to have.
        weighed: mass of the robot on a scale and its standard error [kg]; None: that of the identification.
    """
    check_model_file(path, source)
    _check_robot(identification, robot)
    parameters = base_parameters(robot, support=identification.parameters.support)
    links, full = parameters.tree.links, identification.full
    bodies = None if source is None else PublishedLinks(source, robot)
    cad = pseudo_inertia.pseudo_inertias(robot.model)
    if bodies is not None:
        cad = bodies.by_link(robot.model.nbody - 1)
    elif path.suffix.lower() == ".urdf":
        cad[cad[:, 3, 3] <= LEAST_MASS] = 0.0  # which stands for none, where a file needs a mass
    reference, inertias = with_identified_inertias(pseudo_inertia.solid(cad), identification, links)
    ellipsoids = pseudo_inertia.bounding_ellipsoids(robot.visual_model, reference)
    mass, mass_error = weighed or identification.mass
    value, covariance = full.value, full.covariance
    if full.cad_scales is not None:
        # The postures do not determine all parameters, so CAD says where the masses are that do not show.
        scales = full.cad_scales
        expected = expected_standard(parameters, pseudo_inertia.standard_of(reference), value, mass, scales)
        reference = pseudo_inertia.at_standard(reference, expected)
    elif full.standard is None:  # CAD is not in it yet
        value, covariance = cad_prior(parameters, pseudo_inertia.standard_of(cad)).combined(value, covariance)
    target = Target(parameters.from_standard[full.numbers - 1], value, covariance, mass)
    consistent = consistent_robot(reference, ellipsoids, target)
    away = consistent.value - full.value
    slope = np.eye(len(full.value) + 1)  # of base parameters times the mass, and the mass
    slope[:-1] *= mass
    slope[:-1, -1] = full.value
    known = slope @ block_diag(full.covariance, mass_error**2) @ slope.T
    shares = data_shares(consistent.pseudo, target.from_standard, known)
    content, notes = _content(robot, path, source, bodies, parameters, consistent)
    notes = (*notes, *inertias)
    if adopted:
        notes = (*notes, f"Adopted, but not in the file: {listed(map(str, adopted))}")
    if consistent.misfit:
        nearest = f"the exported one is the nearest, {consistent.misfit:.3g} standard errors away"
        notes = (f"No physically consistent robot has the base parameters; {nearest}.", *notes)
    result = ExportedModel(
        links=exported_links(links, cad, consistent.pseudo, shares),
        base_parameters=consistent.value,
        constant=identification.constant,
        misfit_in_standard_errors=float(np.sqrt(away @ np.linalg.solve(full.covariance, away))),
        total_mass=TotalMass(float(mass), "weighed" if weighed else "by the measured forces"),
        file=str(path),
        notes=notes,
    )
    write_bytes(path, content, new=True)
    if consistent.misfit:
        warn(f"{path}: {notes[0]}")
    if chi2_sf(result.misfit_in_standard_errors**2, len(full.value)) < LEVEL:
        warn(f"{path}: {result.misfit_line} One of both is wrong; `check` and `discover` say more")
    return result


def check_model_file(path: Path, source: Path | None) -> None:
    """Refuse to write a file that exists, or whose ending is not that of a model or of its source."""
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"{path}: found a name that ends in '{path.suffix}', expected {listed(ENDINGS)}")
    check_new(path)
    if source is not None and _kind(source) != path.suffix.lower():
        raise InputError(
            f"{path}: found the ending '{path.suffix}', expected {_kind(source)}, that of the source {source}"
        )


def _check_robot(identification: Identification, robot: Robot) -> None:
    parameters = base_parameters(robot, support=identification.parameters.support)
    known, count = identification.parameters, len(identification.full.numbers)
    if known.tree.links != parameters.tree.links or known.names != parameters.names:
        raise InputError(
            f"{robot.model_file}: found a robot with other links than the identification's; give the robot "
            "that was identified"
        )
    if count != len(parameters.names):
        raise InputError(
            f"found an estimate of {count} of {len(parameters.names)} base parameters, expected all"
        )


def _kind(source: Path) -> str:
    return ".urdf" if b"<robot" in read_bytes(source)[:4096] else ".xml"


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
        note = "Inertias follow CAD. Export the measurement folder for what the motion determines."
        return reference, (note,)
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


def _content(
    robot: Robot,
    path: Path,
    source: Path | None,
    bodies: PublishedLinks | None,
    parameters: BaseParameters,
    consistent: ConsistentRobot,
) -> tuple[bytes, tuple[str, ...]]:
    """Return the bytes of the model, read back and compared, and notes on them."""
    model = robot.model
    if source is not None and bodies is not None:
        content = with_inertias(read_bytes(source), bodies.changed(consistent.pseudo), source)
        read = _published(content, path, robot)
        notes = _missing_files(source, path)
    elif path.suffix.lower() == ".urdf":
        content = written_urdf(robot, consistent.pseudo)
        read = _published(content, path, robot)
        parts = "links, hinges, limits and inertias, without shapes and motors"
        notes = (f"The URDF is generated from the robot's MJCF: {parts}.",)
    else:
        check_unchanged(robot, robot.model_file)
        links = zip(parameters.tree.links, consistent.pseudo, strict=True)
        heavy = {name: pseudo for name, pseudo in links if pseudo[3, 3] > 0}
        content = with_inertias(read_bytes(robot.model_file), heavy, robot.model_file)
        with tempfile.TemporaryDirectory() as scratch:  # a copy of the robot's files
            folder = Path(scratch)
            for name in robot.hashes:
                if present(robot.folder / name) and ".." not in Path(name).parts:
                    write_bytes(folder / name, read_bytes(robot.folder / name))
            place = folder / robot.model_file.relative_to(robot.folder)
            write_bytes(place, content)
            model = load_spec(place, folder).compile()
        parameters = base_parameters(robot, model, parameters.support)
        read, notes = pseudo_inertia.pseudo_inertias(model), _missing_files(robot.model_file, path)
    apart = float(np.abs(parameters.values(pseudo_inertia.standard_of(read)) - consistent.value).max())
    read, wanted = _rigid(read, model), _rigid(consistent.pseudo, model)
    off = np.zeros(len(wanted))
    for k in np.flatnonzero(wanted[:, 3, 3] > LEAST_MASS):
        inverse = np.linalg.inv(np.linalg.cholesky(wanted[k]))
        off[k] = np.abs(inverse @ (read[k] - wanted[k]) @ inverse.T).max()
    if not (off.max() <= ALIKE and apart <= EXACT):
        worst = parameters.tree.links[off.argmax()]
        raise InputError(
            f"{path}: the inertia of {worst} in the written file is away from the stated one by "
            f"{off.max():.2g} of it, base parameters by {1e3 * apart:.2g} mm; a setting of the file "
            "overrules inertias (<compiler>: settotalmass, boundinertia, boundmass, inertiafromgeom)"
        )
    return content, notes


def _rigid(pseudo: np.ndarray, model: mujoco.MjModel) -> np.ndarray:
    """Return pseudo-inertias with those of bodies without a joint in their parents', (n_links, 4, 4)."""
    sums, rotations = pseudo.copy(), rotation_matrices(model.body_quat)
    for body in range(model.nbody - 1, 0, -1):
        parent = int(model.body_parentid[body])
        if model.body_jntnum[body] == 0 and parent > 0:
            place = np.eye(4)
            place[:3, :3], place[:3, 3] = rotations[body], model.body_pos[body]
            sums[parent - 1] += pseudo_inertia.moved(sums[body - 1], place)
            sums[body - 1] = 0.0
    return sums


def _published(content: bytes, path: Path, robot: Robot) -> np.ndarray:
    """Read a file back as a published one; returns the pseudo-inertias of the robot's links, (n, 4, 4)."""
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch) / path.name
        write_bytes(place, content)
        return PublishedLinks(place, robot).by_link(robot.model.nbody - 1)


def _missing_files(source: Path, path: Path) -> tuple[str, ...]:
    """Return a note on files that the model names and that are not found from its new place."""
    if source.parent.resolve() == path.parent.resolve():
        return ()
    if _kind(source) == ".urdf":
        names = {str(mesh.get("filename")) for mesh in ET.fromstring(read_bytes(source)).iter("mesh")}
        missing = sorted(name for name in names if find_mesh(name, source) and not find_mesh(name, path))
    else:
        files = [file for file in mjcf_files(source, source.parent) if file != source]
        names = {os.path.relpath(file, source.parent) for file in files}
        missing = sorted(name for name in names if not present(path.parent / name))
    if not missing:
        return ()
    return (
        f"The model names {len(missing)} files that are not found from its new place "
        f"({shortened(listed(missing), 200)}): move it to the folder of {source}, or copy them.",
    )

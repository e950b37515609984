"""The robot from its MJCF's own geometry, posed by the nominal kinematics."""

from __future__ import annotations

import mujoco
import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from tulip_testbed.colours import NOMINAL, TRUTH
from tulip_testbed.standing import link_frames
from tulip_testbed.viewer.canvas import Canvas, styled
from tulip_testbed.viewer.subject import Subject

SHOWN_GROUPS = (0, 1, 2)  # as MuJoCo's own viewer; collision geometry stands in the others
MARKER = 0.025  # m, radius of the marker of 1 kg
MASS_COLOURS = {"nominal model": NOMINAL, "truth": TRUTH}
GEOM = mujoco.mjtGeom


def log_geometry(recording: rr.RecordingStream, path: str, model: mujoco.MjModel) -> None:
    """Log every link's geoms, in the link's frame, once for all times.

    A link whose geoms are all in hidden groups is drawn with those.
    """
    for body in range(1, model.nbody):
        of_body = np.flatnonzero(model.geom_bodyid == body)
        shown = of_body[np.isin(model.geom_group[of_body], SHOWN_GROUPS)]
        for geom in shown if len(shown) else of_body:
            if (shape := _shape(model, int(geom))) is not None:
                recording.log(f"{path}/{model.body(body).name}/geom{geom}", shape, static=True)


def undrawn(model: mujoco.MjModel) -> list[str]:
    """Return the links that have a mass but no drawn geom."""
    return [
        model.body(body).name
        for body in range(1, model.nbody)
        if model.body_mass[body] > 0
        and not any(_shape(model, int(geom)) for geom in np.flatnonzero(model.geom_bodyid == body))
    ]


def log_motion(canvas: Canvas, subject: Subject) -> None:
    """Log every link's pose in the base frame at every time."""
    rotations, positions = link_frames(subject.nominal, subject.joint_angles, subject.support)
    tree = subject.nominal.parameters.tree
    for link, frame in zip(tree.links, tree.frame_of_link, strict=True):
        canvas.poses(f"world/robot/{link}", Rotation.from_matrix(rotations[:, frame]), positions[:, frame])


def log_skeleton(canvas: Canvas, path: str, subject: Subject, joint_angles: np.ndarray, colour: str) -> None:
    """Log lines from joint to joint at every time, at the measured or the commanded angles."""
    _, positions = link_frames(subject.nominal, joint_angles, subject.support)
    edges = subject.nominal.parameters.tree.edges
    ends = np.array([[edge.parent, edge.child] for edge in edges])
    strips = positions[:, ends].reshape(-1, 2, 3)
    lengths = [len(edges)] * len(joint_angles)
    canvas.rows(path, rr.LineStrips3D, styled(colour, 0.004), lengths, strips=strips)


def log_masses(canvas: Canvas, subject: Subject, masses: dict[str, np.ndarray]) -> None:
    """Log each link's centre of mass as a ball whose volume is proportional to its mass.

    Args:
        masses: standard parameters (eq. 5), (n_links, 4) [kg, kg m], by where they come from.
    """
    rotations, positions = link_frames(subject.nominal, subject.joint_angles, subject.support)
    tree = subject.nominal.parameters.tree
    frames = np.array(tree.frame_of_link)
    for name, standard in masses.items():
        heavy = standard[:, 0] > 0
        mass, of = standard[heavy, 0], frames[heavy]
        local = standard[heavy, 1:] / mass[:, None]
        centres = positions[:, of] + (rotations[:, of] @ local[..., None])[..., 0]
        links = np.array(tree.links)[heavy]
        labels = [f"{link} {kg:.2f} kg" for link, kg in zip(links, mass, strict=True)]
        style = styled(MASS_COLOURS[name], MARKER * np.cbrt(mass), labels=labels, show_labels=False)
        path, lengths = f"world/masses/{name.replace(' ', '_')}", [len(mass)] * len(subject)
        canvas.rows(path, rr.Points3D, style, lengths, positions=centres.reshape(-1, 3))


def height_of(subject: Subject) -> float:
    """Return the height of the robot's highest geom over the ground, the median of all postures [m]."""
    model, tree = subject.nominal.robot.model, subject.nominal.parameters.tree
    rotations, positions = link_frames(subject.nominal, subject.joint_angles, subject.support)
    frame = np.array(tree.frame_of_link)[model.geom_bodyid - 1]
    # Rows of the rotations that give z; a geom's own sphere reaches as far upwards as in any direction.
    middle = positions[:, frame, 2] + (rotations[:, frame, 2] * model.geom_pos).sum(axis=-1)
    return float(np.median((middle + model.geom_rbound).max(axis=1)))


def _shape(model: mujoco.MjModel, geom: int) -> rr.AsComponents | None:
    """Return a geom for rerun; None for types that a robot's link does not have (planes, height fields)."""
    kind, size = GEOM(int(model.geom_type[geom])), model.geom_size[geom]
    position, (w, x, y, z) = model.geom_pos[geom], model.geom_quat[geom]
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    if kind == GEOM.mjGEOM_MESH:
        return _mesh(model, geom, rgba)
    style = {
        "quaternions": [rr.Quaternion(xyzw=[x, y, z, w])],
        "colors": [rgba],
        "fill_mode": rr.components.FillMode.Solid,
    }
    if kind == GEOM.mjGEOM_BOX:
        return rr.Boxes3D(half_sizes=[size], centers=[position], **style)
    if kind in (GEOM.mjGEOM_SPHERE, GEOM.mjGEOM_ELLIPSOID):
        half = size if kind == GEOM.mjGEOM_ELLIPSOID else np.full(3, size[0])
        return rr.Ellipsoids3D(half_sizes=[half], centers=[position], **style)
    along = {"lengths": [2 * size[1]], "radii": [size[0]], **style}
    if kind == GEOM.mjGEOM_CYLINDER:
        return rr.Cylinders3D(centers=[position], **along)
    if kind == GEOM.mjGEOM_CAPSULE:
        # MuJoCo puts a capsule by its middle, rerun by the middle of one of its ends.
        end = position - Rotation.from_quat([x, y, z, w]).apply([0, 0, size[1]])
        return rr.Capsules3D(translations=[end], **along)
    return None


def _mesh(model: mujoco.MjModel, geom: int, rgba: np.ndarray) -> rr.Mesh3D:
    """Return a mesh as triangles with normals, without which rerun draws no shade."""
    mesh = model.geom_dataid[geom]
    faces = model.mesh_faceadr[mesh] + np.arange(model.mesh_facenum[mesh])
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] + model.mesh_face[faces].ravel()]
    normals = model.mesh_normal[model.mesh_normaladr[mesh] + model.mesh_facenormal[faces].ravel()]
    turned = Rotation.from_quat(model.geom_quat[geom], scalar_first=True)
    return rr.Mesh3D(
        vertex_positions=turned.apply(vertices) + model.geom_pos[geom],
        vertex_normals=turned.apply(normals),
        albedo_factor=rgba,
    )

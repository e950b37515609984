"""The robot from its MJCF's own geometry, posed by the nominal kinematics, on its plates and their loads."""

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy.spatial.transform import Rotation

from tulip_testbed.colours import CELL_COLOURS, NOMINAL, TRUTH, rgb
from tulip_testbed.identification.center_of_pressure import cell_positions
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.rendering import BARE_COLOUR, DOT
from tulip_testbed.sim.random_robots import half_edges
from tulip_testbed.viewer.canvas import Canvas, styled
from tulip_testbed.viewer.subject import Subject

SHOWN_GROUPS = (0, 1, 2)  # as MuJoCo's own viewer; collision geometry stands in the others
MARKER = 0.025  # m, radius of the marker of 1 kg
CELL_RADIUS = 0.012  # m
BOARD_COLOUR, THICKNESS = (158, 184, 204), 0.6  # share of the height that is board, not cell
METRES_PER_WEIGHT = 1.0  # an arrow of this length carries the robot's whole weight
EYE = (1.5, -1.05, 0.85)  # m, of a robot as tall as TULip
TULIP_HEIGHT = 1.25  # m
MASS_COLOURS = {"nominal model": NOMINAL, "truth": TRUTH}
GEOM = mujoco.mjtGeom


def log_geometry(recording: rr.RecordingStream, path: str, model: mujoco.MjModel) -> None:
    """Log every link's geoms, in the link's frame, once for all times.

    A link whose geoms are all in hidden groups is drawn with those, and one that no geom shows as the box of
    its inertia.
    """
    bare = undrawn(model)
    for body in range(1, model.nbody):
        of_body = np.flatnonzero(model.geom_bodyid == body)
        shown = of_body[np.isin(model.geom_group[of_body], SHOWN_GROUPS)]
        shapes = {f"geom{geom}": _shape(model, int(geom)) for geom in (shown if len(shown) else of_body)}
        if model.body(body).name in bare:
            shapes["inertia"] = inertia_box(model, body)
        for name, shape in shapes.items():
            if shape is not None:
                recording.log(f"{path}/{model.body(body).name}/{name}", shape, static=True)


def undrawn(model: mujoco.MjModel) -> list[str]:
    """Return the links that have a mass but no drawn geom larger than a dot."""
    large = [geom for geom in np.flatnonzero(model.geom_rbound > DOT) if _shape(model, int(geom))]
    drawn = set(model.geom_bodyid[large])
    return [model.body(k).name for k in range(1, model.nbody) if model.body_mass[k] > 0 and k not in drawn]


def log_motion(canvas: Canvas, subject: Subject) -> None:
    """Log every link's pose in the base frame at every time."""
    rotations, positions = subject.nominal.geometry(subject.rows.joint_angles, subject.rows.support).frames
    tree = subject.nominal.parameters.tree
    for link, frame in zip(tree.links, tree.frame_of_link, strict=True):
        canvas.poses(f"world/robot/{link}", Rotation.from_matrix(rotations[:, frame]), positions[:, frame])


def log_skeleton(canvas: Canvas, path: str, subject: Subject, joint_angles: np.ndarray, colour: str) -> None:
    """Log lines from joint to joint at every time, at the measured or the commanded angles."""
    _, positions = subject.nominal.geometry(joint_angles, subject.rows.support).frames
    edges = subject.nominal.parameters.tree.edges
    ends = np.array([[edge.parent, edge.child] for edge in edges])
    strips = positions[:, ends].reshape(-1, 2, 3)
    lengths = [len(edges)] * len(joint_angles)
    canvas.rows(path, rr.LineStrips3D, styled(colour, 0.004), lengths, strips=strips)


def log_masses(canvas: Canvas, subject: Subject, masses: dict[str, np.ndarray]) -> None:
    """Log each link's centre of mass as a ball whose volume is proportional to its mass.

    Standard parameters (eq. 5) go by where they come from, (n_links, 4) [kg, kg m].
    """
    rotations, positions = subject.nominal.geometry(subject.rows.joint_angles, subject.rows.support).frames
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
    """Return the height of the highest geom or link's centre of mass, the median of all postures [m]."""
    model, tree = subject.nominal.robot.model, subject.nominal.parameters.tree
    rotations, positions = subject.nominal.geometry(subject.rows.joint_angles, subject.rows.support).frames
    frame = np.array(tree.frame_of_link)[model.geom_bodyid - 1]
    # Rows of the rotations that give z; a geom's own sphere reaches as far upwards as in any direction.
    middle = positions[:, frame, 2] + (rotations[:, frame, 2] * model.geom_pos).sum(axis=-1)
    links = np.array(tree.frame_of_link)
    centres = positions[:, links, 2] + (rotations[:, links, 2] * model.body_ipos[1:]).sum(axis=-1)
    return float(np.median(np.column_stack([middle + model.geom_rbound, centres]).max(axis=1)))


def space_view(subject: Subject, name: str, contents: list[str]) -> rrb.Spatial3DView:
    """Return the view of a part of the world, observed from the robot's front right."""
    height = height_of(subject)
    eye = rrb.EyeControls3D(
        position=tuple(height / TULIP_HEIGHT * np.array(EYE)),
        look_target=(0.0, 0.1, 0.4 * height),
        eye_up=(0.0, 0.0, 1.0),
    )
    return rrb.Spatial3DView(
        origin="world",
        name=name,
        contents=contents,
        background=(238, 241, 244),
        line_grid=False,
        eye_controls=eye,
    )


def log_plates(canvas: Canvas, subject: Subject) -> None:
    """Log boards and cells at their recorded poses; the boards' top is z = 0. Sensors in feet have none."""
    if subject.sensors_in_feet:
        return
    for k, plate in enumerate(PLATES):
        poses, height = subject.plates[:, k], float(subject.top_height[k])
        half = [*(subject.board.size / 2), THICKNESS * (height or subject.board.top_height) / 2]
        place = np.column_stack([poses[:, :2], np.zeros(len(poses))])
        entity = f"world/plates/{plate}"
        canvas.poses(entity, Rotation.from_rotvec(poses[:, 2, None] * [0, 0, 1]), place)
        board = rr.Boxes3D(
            half_sizes=[half],
            centers=[[0, 0, -half[2]]],
            colors=[BOARD_COLOUR],
            fill_mode=rr.components.FillMode.Solid,
        )
        canvas.recording.log(f"{entity}/board", board, static=True)
        if not len(subject.cells[k]):
            continue
        cells = np.column_stack([subject.cells[k], np.full(4, CELL_RADIUS - height)])
        feet = rr.Points3D(cells, radii=CELL_RADIUS, colors=[rgb(colour) for colour in CELL_COLOURS])
        canvas.recording.log(f"{entity}/cells", feet, static=True)


def log_loads(canvas: Canvas, subject: Subject) -> None:
    """Log the load on every cell, or on each foot if there are no cells; a plan has no loads.

    It is an arrow down onto the board; a negative reading points up.
    """
    positions, forces = subject.load_points, subject.foot_loads
    if subject.measurements is not None and subject.cell_forces is not None:
        positions, forces = cell_positions(subject.measurements), subject.cell_forces
    if positions is None or forces is None:
        return
    length = METRES_PER_WEIGHT * forces / subject.weight
    zero = np.zeros_like(length)
    origins = np.dstack([positions, length]).reshape(-1, 3)
    vectors = np.dstack([zero, zero, -length]).reshape(-1, 3)
    count = forces.shape[1]
    colours = [rgb(colour) for colour in CELL_COLOURS] * 2 if count == 8 else [rgb(CELL_COLOURS[0])]
    style, lengths = {"colors": colours, "radii": 0.006}, [count] * len(forces)
    canvas.rows("world/loads", rr.Arrows3D, style, lengths, origins=origins, vectors=vectors)


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


def inertia_box(model: mujoco.MjModel, body: int) -> rr.Boxes3D:
    """Return the box of even density that has the mass and the inertia of a link."""
    w, x, y, z = model.body_iquat[body]
    return rr.Boxes3D(
        half_sizes=[half_edges(model)[body - 1]],
        centers=[model.body_ipos[body]],
        quaternions=[rr.Quaternion(xyzw=[x, y, z, w])],
        colors=[BARE_COLOUR],
        fill_mode=rr.components.FillMode.Solid,
    )


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

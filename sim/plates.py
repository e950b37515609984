"""The two force plates in the scene: their poses, and the readings of their cells."""

import mujoco
import numpy as np

from tulip_testbed.base.errors import InputError
from tulip_testbed.measurements.cells import CORNERS, PLATES, PlateGeometry


def plate_geometry(spec: mujoco.MjSpec, plate: str) -> PlateGeometry:
    body = spec.body(f"{plate}_plate")
    if body is None:
        raise InputError(f"scene '{spec.modelname}': found no body '{plate}_plate', expected one per plate")
    top = spec.geom(f"{plate}_plate_top")
    sites = [spec.site(f"{plate}_plate_{corner}") for corner in CORNERS]
    if top is None or None in sites:
        raise InputError(
            f"scene '{spec.modelname}': {plate} plate: no geom '{plate}_plate_top' or no four sites "
            f"'{plate}_plate_CORNER'"
        )
    return PlateGeometry(
        cells=np.array([site.pos[:2] for site in sites]),
        size=2 * np.array(top.size[:2]),
        top_height=float(top.pos[2] + top.size[2]),
        mass=float(body.mass),
    )


def place_plates(spec: mujoco.MjSpec, poses: np.ndarray) -> None:
    """Move both plates to their poses in the base frame, (2, 3) [m, m, rad]."""
    for plate, (x, y, yaw) in zip(PLATES, poses, strict=True):
        frame = spec.frame(f"{plate}_plate_place")
        if frame is None:
            raise InputError(f"scene '{spec.modelname}': found no frame '{plate}_plate_place', expected one")
        frame.pos = [x, y, frame.pos[2]]
        frame.quat = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]


def cell_names() -> list[str]:
    """List the names of the eight cells' sites and sensors in the scene, in the order of `CELLS`."""
    return [f"{plate}_plate_{corner}" for plate in PLATES for corner in CORNERS]


def cell_addresses(model: mujoco.MjModel) -> np.ndarray:
    """Return the addresses of the eight cells in `sensordata`, in the order of `CELLS`, (8,)."""
    return np.array([model.sensor(name).adr[0] for name in cell_names()])


def short_feet(model: mujoco.MjModel) -> np.ndarray:
    """Return by how much the foot at each cell is shorter than the longest of its plate, (2, 4) [m]."""
    heights = []
    for name in cell_names():
        geom = model.geom(name)
        body = int(geom.bodyid[0])
        hung = model.body(body).name == f"{name}_cell"  # compliant cells are bodies of their own
        heights.append(geom.pos[2] + (model.body_pos[body, 2] if hung else 0.0))
    by_plate = np.reshape(heights, (len(PLATES), len(CORNERS)))
    return by_plate - by_plate.min(axis=1, keepdims=True)


def tare(model: mujoco.MjModel) -> np.ndarray:
    """Simulate the readings of the eight cells under the empty plates, (8,) [N].

    The robot is lifted by 100 m, so that it does not land within the simulated second.
    """
    data = mujoco.MjData(model)
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)[0]
    data.qpos[model.jnt_qposadr[free] + 2] += 100.0
    mujoco.mj_step(model, data, round(1.0 / model.opt.timestep))
    return data.sensordata[cell_addresses(model)].copy()

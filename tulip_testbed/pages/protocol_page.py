"""The folder of a laboratory day: pages to print, trajectories, the start of the measurements."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from tulip_testbed.base.files import new_folder, write_text
from tulip_testbed.experiments.example import empty_measurements
from tulip_testbed.experiments.protocols.motion import FREE
from tulip_testbed.experiments.protocols.protocol_run import LaboratoryProtocol
from tulip_testbed.measurements import Measurements, PosturePlan
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.measurements.measurement_folder import write_start
from tulip_testbed.pages.page import filled
from tulip_testbed.pages.pictures import addresses
from tulip_testbed.pages.placement_drawing import drawing, marks, placement_of, scale_for
from tulip_testbed.sim.plan_folder import write_plan

KNOWN = ("posture", "placement", "support")  # columns of the rows to fill in that the plan knows
TEMPLATE = "protocol.html.j2"
PAGE, PLAN, TRAJECTORIES = "protocol.html", "plan", "trajectories"
MEASUREMENTS, ROWS = "measurements", "rows.csv"
SIZE = (240, 320)  # pixels, of a posture's picture
COLUMNS = 6  # postures beside each other
SUPPORTS = {"double": "both feet", "right": "right foot", "left": "left foot"}

BEFORE = (
    "Both boards and the floor below them are level.",
    "Sensors and drives have warmed up for half an hour.",
    "Nothing loads the sensors: they are tared, and their readings are written down on the last page.",
    "A known mass was placed on each board at each corner; the sensors read it.",
    "The encoders' zeros are checked at their marks.",
    "The robot is weighed, with everything attached to it; mass and standard deviation are in manifest.json.",
    "No cable or rope pulls at the robot: they hang slack in every posture.",
    "The hoist can carry the robot, and somebody holds the emergency stop.",
    "One trajectory was run in the air, slowly.",
    "Date, people and temperature are written down.",
)
AFTER = (
    "Nothing loads the sensors: their zeros are read again and written down below. Do not tare before.",
    "The encoders' zeros are read again at their marks.",
    "The robot is weighed again.",
    "The temperature is written down.",
    "Rows and manifest are complete: tulip check finds no fault.",
)


def write_protocol(folder: Path, protocol: LaboratoryProtocol) -> list[str]:
    """Write a protocol as a new folder, whole or not at all; return why pictures are missing."""
    plan, robot = protocol.plan, protocol.robot
    empty = empty_measurements(robot, protocol.sensors)
    with new_folder(folder) as working:
        page, missing = protocol_page(protocol)
        write_text(working / PAGE, page)
        write_plan(working / PLAN, plan)
        (working / TRAJECTORIES).mkdir()
        for k, motion in enumerate(protocol.motions):
            if motion is not None:
                name = working / TRAJECTORIES / motion.name(k + 1)
                write_text(name.with_suffix(".csv"), motion.csv(plan.joints))
                write_text(name.with_suffix(".yaml"), motion.yaml(plan.joints))
        write_start(working / MEASUREMENTS, empty)
        write_text(working / ROWS, rows_to_fill_in(empty, plan))
    return missing


def contents(folder: Path) -> list[str]:
    return [str(folder / name) for name in (PAGE, PLAN, TRAJECTORIES, MEASUREMENTS, ROWS)]


def protocol_page(protocol: LaboratoryProtocol) -> tuple[str, list[str]]:
    """Return the page as HTML that loads nothing from the network, and the pictures that are missing."""
    missing: list[str] = []
    plan, robot = protocol.plan, protocol.robot
    _, once = np.unique(plan.posture, return_index=True)
    drawn = addresses(robot, plan, once, protocol.boards, SIZE, missing)
    pictures = dict(zip(plan.posture[once].tolist(), drawn, strict=False))
    first = {number: int(np.flatnonzero(plan.placement == number)[0]) for number in protocol.placements}
    placed = {
        number: placement_of(
            robot, protocol.boards[row], plan.foot_poses[row], plan.support[plan.placement == number]
        )
        for number, row in first.items()
    }
    scale = scale_for(list(placed.values()))
    sheets = []
    for number, placement in placed.items():
        rows = [_row(protocol, int(k), pictures) for k in np.flatnonzero(plan.placement == number)]
        boards = [
            (side, f"{1e3 * x:.1f}, {1e3 * y:.1f}, {np.rad2deg(yaw):.1f}")
            for side, (x, y, yaw) in zip(PLATES, placement.boards, strict=True)
        ]
        sheets.append(
            {
                "number": number,
                "svg": Markup(drawing(placement, scale)),
                "marks": marks(placement),
                "boards": boards,
                "datum": ("right", "left")[placement.datum],
                "groups": [rows[k : k + COLUMNS] for k in range(0, len(rows), COLUMNS)],
            }
        )
    empty = empty_measurements(robot, protocol.sensors)
    contacts, sheet = empty.contacts, dataclasses.asdict(empty.sensors)
    unknown = [key for key, v in sheet.items() if v is None and (contacts is None or "cell" not in key)]
    page = filled(
        TEMPLATE,
        protocol=protocol,
        content=protocol.to_json(),
        joints=plan.joints,
        sheets=sheets,
        scale=scale,
        before=BEFORE,
        after=AFTER,
        unknown=["weighed_mass", *(f"sensors.{name}" for name in unknown)],  # for a person to fill in
        on_ground=empty.on_plates,
        channels=[f"{c.replace('_', ' ')}, N" for c in CORNERS] if contacts is None else contacts.channels,
        missing=missing,
    )
    return page, missing


def _row(protocol: LaboratoryProtocol, k: int, pictures: dict[int, str]) -> dict[str, Any]:
    """Return a posture on the page; angles in degrees, in the order of the joints."""
    plan, motion = protocol.plan, protocol.motions[k]
    number, arrive = int(plan.posture[k]), "Set down again from the hoist, in this posture."
    if motion is not None:
        hung = "" if motion.kind == FREE else " In the hoist, feet in place; then let it stand."
        by = " By a stance between the feet." if motion.via_stance else ""
        arrive = f"Trajectory {k + 1:03d}, {motion.duration:.1f} s.{by}{hung}"
    return {
        "number": number,
        "picture": pictures.get(number, ""),
        "arrive": arrive,
        "support": SUPPORTS[str(plan.support[k])],
        "repeat": bool((plan.posture[:k] == number).any()),
        "angles": [f"{angle:.2f}" for angle in np.rad2deg(plan.joint_angles[k])],
    }


def rows_to_fill_in(empty: Measurements, plan: PosturePlan) -> str:
    """Return the rows to measure as CSV in the columns of the measurement folder, without readings."""
    columns = list(empty.columns())
    known = zip(*(getattr(plan, name).tolist() for name in KNOWN), strict=True)
    rows = [[str(dict(zip(KNOWN, row, strict=True)).get(name, "")) for name in columns] for row in known]
    return "\n".join(",".join(row) for row in [columns, *rows]) + "\n"

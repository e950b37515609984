"""A small humanoid as people publish them: a URDF with all that makes such files hard to use."""

from pathlib import Path

import trimesh

from tests.edited_files import change_texts

LEG = (
    ("hip_yaw", "0 0 1", "0 0 0", 0.6, "-1 1"),
    ("hip_roll", "1 0 0", "0 0 0", 0.5, "-0.6 0.6"),
    ("hip_pitch", "0 1 0", "0 0 0", 2.5, "-1.6 0.6"),
    ("knee", "0 1 0", "0 0 -0.3", 1.8, "-0.05 2"),
    ("ankle_pitch", "0 1 0", "0 0 -0.3", 0.3, "-0.9 0.6"),
    ("ankle_roll", "1 0 0", "0 0 0", 0.9, "-0.5 0.5"),
)
BOX = '<geom type="box" size=".1 .04 .01" pos=".03 0 -.05"/>'  # the foot of an MJCF
SOLE = (0.15, -0.07, 0.045, -0.035, 0.06)  # front, rear, outer and inner edge, ankle's height [m]
MASS = 2 * sum(link[3] for link in LEG) + 9.0 + 6.0 + 2 * (1.1 + 0.8 + 0.01) + 0.15


def write_published(folder: Path, turn: float = 0.0, names: tuple[str, str] = ("right", "left")) -> Path:
    """Write humanoid.urdf and its meshes.

    Args:
        turn: of the whole robot about the vertical against its file's axes [rad].
        names: of the right and the left side.
    """
    (folder / "meshes").mkdir(parents=True)
    torso = trimesh.creation.box(extents=(0.18, 0.3, 0.4))
    torso.export(folder / "meshes" / "torso.stl")
    # Collada with y up, as Blender writes it.
    head = trimesh.creation.box(extents=(0.1, 0.2, 0.12))
    head.export(folder / "meshes" / "head.dae")
    dae = (folder / "meshes" / "head.dae").read_text()
    (folder / "meshes" / "head.dae").write_text(dae.replace("Z_UP", "Y_UP"))
    parts = [
        link("pelvis", 9.0, "0.01 0 0.02", box("0.16 0.24 0.12")),
        link("imu", None),
        joint("imu_fixed", "fixed", "pelvis", "imu", "0 0 0.1"),
        link("chest", 6.0, "0 0 0.2", mesh("torso.stl", "0 0 0.2")),
        joint("waist", "revolute", "pelvis", "chest", "0 0 0.08", "0 0 1", "-1 1", 40),
        link("head", 0.15, "0 0 0.05", mesh("head.dae", "0 0 0.1")),
        joint("neck", "revolute", "chest", "head", "0 0 0.42", "0 0 1", "-1 1", 2),
        link("lidar", None, "", mesh("lidar.stl", "0 0 0")),
        joint("lidar_fixed", "fixed", "head", "lidar", "0 0 0.2"),
    ]
    for name, side in zip(names, (-1, 1), strict=True):
        above = "pelvis"
        for k, (part, axis, place, mass, limits) in enumerate(LEG):
            here = f"0 {0.1 * side} -0.06" if k == 0 else place
            shape = box("0.06 0.06 0.2", "0 0 -0.15") if part in ("hip_pitch", "knee") else ""
            if part == "ankle_roll":
                front, rear, outer, inner, height = SOLE
                size = f"{front - rear} {outer - inner} 0.02"
                shape = box(size, f"{(front + rear) / 2} {side * (outer + inner) / 2} {0.01 - height}")
            center = "0.02 0 -0.03" if part == "ankle_roll" else "0.005 0 -0.12"
            parts += [
                link(f"{name}_{part}_link", mass, center, shape),
                joint(f"{name}_{part}", "revolute", above, f"{name}_{part}_link", here, axis, limits, 60),
            ]
            above = f"{name}_{part}_link"
        arm, forearm = f"{name}_arm", f"{name}_forearm"
        shoulder = ("chest", arm, f"0 {0.2 * side} 0.35", "0 1 0", "-2 2", 15)
        finger = (forearm, f"{name}_finger", "0 0 -0.24", "1 0 0", "0 1", 1)
        mimic = f'<mimic joint="{name}_elbow"/></joint>'
        parts += [
            link(arm, 1.1, "0 0 -0.1", box("0.05 0.05 0.22", "0 0 -0.12")),
            joint(f"{name}_shoulder", "revolute", *shoulder),
            link(forearm, 0.8, "0.02 0 -0.1", box("0.04 0.04 0.22", "0 0 -0.12")),
            joint(f"{name}_elbow", "continuous", arm, forearm, "0 0 -0.26", "0 1 0", None, 10),
            link(f"{name}_finger", 0.01),
            joint(f"{name}_finger", "revolute", *finger).replace("</joint>", mimic),
        ]
    if turn:
        parts += [
            link("base", None),
            joint("base_fixed", "fixed", "base", "pelvis", "0 0 0", rpy=f"0 0 {turn}"),
        ]
    path = folder / "humanoid.urdf"
    path.write_text(f'<?xml version="1.0"?>\n<robot name="humanoid">\n{"".join(parts)}</robot>\n')
    return path


def write_changed(folder: Path, changes: list[str]) -> Path:
    """Write a published robot as URDF and MJCF beside odd meshes and change a file; return its path."""
    write_published(folder).rename(folder / "robot.urdf")
    (folder / "robot.xml").write_text(mjcf())
    (folder / "flat.obj").write_text("v 0 0 0\nv .1 0 0\nv .1 .1 0\nv 0 .1 0\nf 1 2 3\nf 1 3 4\n")
    (folder / "cut.stl").write_bytes((folder / "meshes" / "torso.stl").read_bytes()[:300])
    change_texts(folder, changes)
    return folder / changes[0].partition(":")[0]


def link(name: str, mass: float | None, center: str = "0 0 0", shape: str = "") -> str:
    inertia = ""
    if mass is not None:
        i = f"{mass * 0.01:.6f}"
        inertia = (
            f'<inertial><origin xyz="{center}"/><mass value="{mass}"/>'
            f'<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>'
        )
    return f'<link name="{name}">{inertia}{shape}</link>\n'


def joint(name, kind, parent, child, place, axis="1 0 0", limits=None, effort=0, rpy="0 0 0") -> str:
    low, high = (limits or "0 0").split()
    limit = f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="5"/>' if kind != "fixed" else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{place}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}</joint>\n'
    )


def box(size: str, place: str = "0 0 0") -> str:
    return f'<collision><origin xyz="{place}"/><geometry><box size="{size}"/></geometry></collision>'


def mesh(file: str, place: str) -> str:
    return (
        f'<visual><origin xyz="{place}"/><geometry><mesh filename="package://humanoid/meshes/{file}"/>'
        "</geometry></visual>"
    )


def mjcf(legs: int = 6, more: str = "", foot: str = BOX) -> str:
    """An MJCF humanoid with `legs` hinges a leg."""
    axes = ("0 0 1", "1 0 0", "0 1 0", "0 1 0", "0 1 0", "1 0 0")[:legs]
    chains = []
    for side, y in (("right", -0.1), ("left", 0.1)):
        text = end = ""
        for k, axis in enumerate(axes):
            place = f"0 {y} 0" if k == 0 else "0 0 -.3" if k in (3, 4) else "0 0 0"
            shape = foot if k == len(axes) - 1 else ""
            text += (
                f'<body name="{side}{k}" pos="{place}">'
                f'<joint name="{side}{k}" axis="{axis}" range="-60 100"/>'
                f'<inertial pos="0 0 -.1" mass="1" diaginertia=".01 .01 .01"/>{shape}'
            )
            end += "</body>"
        chains.append(text + end)
    return f"""<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>
<body name="trunk" pos="0 0 .7"><freejoint/><inertial pos="0 0 .2" mass="10" diaginertia=".2 .2 .1"/>
{"".join(chains)}</body></worldbody>{more}</mujoco>"""

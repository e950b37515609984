"""The smallest distances between the links of a robot in a plan's postures and on the paths between them."""

from itertools import pairwise
from typing import Any

import numpy as np

from tulip_testbed.base.errors import listed
from tulip_testbed.base.table import Table
from tulip_testbed.identification.link_clearances import (
    LinkPairs,
    clearances_at,
    link_pairs,
    overlaps_at_reference,
)
from tulip_testbed.identification.link_paths import path_clearances
from tulip_testbed.identification.planning.one_foot import with_feet_exchanged
from tulip_testbed.identification.planning_ranges import planning_margins
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.measurements.data import base_foot
from tulip_testbed.sim.path import ClosedChain, straight_path
from tulip_testbed.sim.robot import Robot

WITHIN = 0.03  # m, larger distances are not listed
LISTED = 5  # pairs of links


def clearances_of(robot: Robot, plan: PosturePlan) -> dict[str, list[dict[str, Any]]]:
    """Find the pairs of links that come nearest to each other, the ground included, as JSON.

    Args:
        plan: its postures; the paths are the laboratory's between the postures of a placement.

    Returns:
        "postures" and "paths": links, distance [mm] and the posture, or the two that the path connects;
        "left_out": links that overlap in the posture `stand`, which may do so in plans.
    """
    margin = planning_margins(robot).link_clearance
    pairs, foot = link_pairs(robot, margin), base_foot(plan.support)
    held = np.full((len(plan), len(pairs.names)), WITHIN)
    chain = ClosedChain(robot.model, robot)
    same = (plan.placement[1:] == plan.placement[:-1]) & (plan.support[1:] == plan.support[:-1])
    ways = np.full((int(same.sum()), len(pairs.names)), WITHIN)
    steps = [step for step, kept in zip(pairwise(range(len(plan))), same, strict=True) if kept]
    for carrying in np.unique(foot):
        own = pairs if carrying == 0 else link_pairs(with_feet_exchanged(robot), margin)
        columns = np.array([pairs.names.index(name) for name in own.names], int)
        rows = np.flatnonzero(foot == carrying)
        held[np.ix_(rows, columns)] = clearances_at(own, plan.joint_angles[rows], WITHIN).distance
        for k, (start, end) in enumerate(steps):
            if foot[start] == carrying:
                path = chain.path if plan.support[start] == "double" else straight_path
                ends = plan.joint_angles[start], plan.joint_angles[end]
                on_way = path_clearances(own, path, *ends, WITHIN)
                ways[k, columns] = on_way.distance.min(axis=0, initial=WITHIN)
    return {
        "postures": _nearest(pairs, held, [[int(number)] for number in plan.posture]),
        "paths": _nearest(pairs, ways, [[int(plan.posture[k]) for k in step] for step in steps]),
        "left_out": [
            {"links": list(names), "distance_mm": -1e3 * overlap}
            for names, overlap in overlaps_at_reference(robot).items()
        ],
    }


def clearance_table(clearances: dict[str, list[dict[str, Any]]]) -> Table | str:
    """Return the table of `clearances_of`, or a sentence if all links are far from each other."""
    rows = [
        [" and ".join(entry["links"]), entry["distance_mm"], where, " to ".join(map(str, entry["at"]))]
        for where, entries in (("posture", clearances["postures"]), ("path", clearances["paths"]))
        for entry in entries
    ]
    left_out = listed(
        f"{' and '.join(entry['links'])} ({-entry['distance_mm']:.0f} mm)"
        for entry in clearances.get("left_out", ())
    )
    note = f" Left out, since they overlap in the posture stand: {left_out}." if left_out else ""
    if not rows:
        return f"No links come nearer to each other than {1e3 * WITHIN:.0f} mm.{note}"
    heads = ("links", ("distance", "mm", ".1f"), "in a", "posture")
    title = "Smallest distances between links, in postures and on the paths between them"
    return Table(title, heads, rows, f"Negative: the shapes of the links overlap.{note}")


def _nearest(pairs: LinkPairs, distance: np.ndarray, places: list[list[int]]) -> list[dict[str, Any]]:
    """List the smallest distances by pair of links, from (k, p) [m], nearest first."""
    if not distance.size:
        return []
    least, at = distance.min(axis=0), distance.argmin(axis=0)
    order = [int(k) for k in np.argsort(least, kind="stable")[:LISTED] if least[k] < WITHIN]
    return [
        {"links": list(pairs.names[k]), "distance_mm": float(1e3 * least[k]), "at": places[at[k]]}
        for k in order
    ]

"""The folder of an atlas: its page, its document, the biases as CSV, a heat map of the angles."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from markupsafe import Markup

from tulip_testbed.base.files import new_folder, write_text
from tulip_testbed.base.table_files import write_json
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.experiments.atlases.atlas_result import (
    LEGEND,
    PAGE,
    Atlas,
    atlas_tables,
    closing,
    opening,
)
from tulip_testbed.experiments.atlases.isolability import ISOLABLE, order
from tulip_testbed.pages.heat_map_figures import heat_map
from tulip_testbed.pages.page import Page, Section, html

SEPARATION = "separation.html"


def write_atlas(folder: Path, found: Atlas) -> None:
    """Write the folder, which appears whole or not at all.

    Raises:
        InputError: the folder exists or cannot be written.
    """
    with new_folder(folder) as working:
        write_json(working / "atlas.json", found.to_json())
        write_text(working / "bias.csv", biases(found))
        write_text(working / SEPARATION, separation(found))
        write_text(working / PAGE, html(atlas_page(found)))


def atlas_page(found: Atlas) -> Page:
    """Make the page of all effects, with a box to search them."""
    facts = (("sensors", found.planned.sensors), ("seed", str(found.planned.seed)))
    sections = [Section(table.title, tables=(table,)) for table in atlas_tables(found)]
    angles = Markup('<a href="{}">All angles between effects as a map</a>').format(SEPARATION)
    robot = found.planned.nominal.robot
    return Page(
        f"{robot.name}: atlas",
        "",
        f"{opening(found)} {closing(found)}",
        facts,
        tuple(sections),
        story=(LEGEND, angles),
        searched=True,
    )


def biases(found: Atlas) -> str:
    """Return as CSV the bias of every parameter by every effect at its plausible size [mm, s.e.]."""
    numbers = range(1, len(found.planned.standard_errors) + 1)
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    columns = [f"{number}_{unit}" for unit in ("mm", "se") for number in numbers]
    table.writerow(["effect", "target", "parameter", *columns])
    for row in found.rows:
        both = np.concatenate([1e3 * row.bias, row.bias / found.planned.standard_errors])
        name = row.candidate.effect.name
        table.writerow([name, row.candidate.target, row.name, *(f"{value:.4g}" for value in both)])
    return text.getvalue()


def separation(found: Atlas) -> str:
    """Return a heat map of the angles as HTML; of effects on placements only the first is shown."""
    placed = [k for k, c in enumerate(found.shown) if c.effect.targets is PLACEMENTS]
    kept = [k for k in range(len(found.shown)) if k not in placed[1:]]
    chosen = [kept[k] for k in order(found.angle[np.ix_(kept, kept)])]
    degrees = np.degrees(found.angle[np.ix_(chosen, chosen)])
    bound = float(np.degrees(ISOLABLE))
    sensors = found.planned.sensors
    title = f"Angle between effects, sensors {sensors}: below {bound:.0f} deg (brown) they look alike"
    return heat_map(degrees, [found.shown[k].label for k in chosen], title, "deg", 90.0, bound)

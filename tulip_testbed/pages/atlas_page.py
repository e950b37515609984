"""The folder of an atlas: its page and its document."""

from __future__ import annotations

from pathlib import Path

from tulip_testbed.base.files import new_folder, write_text
from tulip_testbed.base.table_files import write_json
from tulip_testbed.experiments.atlases.atlas_result import (
    LEGEND,
    PAGE,
    Atlas,
    atlas_tables,
    closing,
    opening,
)
from tulip_testbed.pages.page import Page, Section, html


def write_atlas(folder: Path, found: Atlas) -> None:
    """Write the folder, which appears whole or not at all.

    Raises:
        InputError: the folder exists or cannot be written.
    """
    with new_folder(folder) as working:
        write_json(working / "atlas.json", found.to_json())
        write_text(working / PAGE, html(atlas_page(found)))


def atlas_page(found: Atlas) -> Page:
    """Make the page of all effects, with a box to search them."""
    facts = (("sensors", found.planned.sensors), ("seed", str(found.planned.seed)))
    sections = [Section(table.title, tables=(table,)) for table in atlas_tables(found)]
    robot = found.planned.nominal.robot
    return Page(
        f"{robot.name}: atlas",
        "",
        f"{opening(found)} {closing(found)}",
        facts,
        tuple(sections),
        story=(LEGEND,),
        searched=True,
    )

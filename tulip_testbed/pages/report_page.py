"""The page of any run."""

from __future__ import annotations

from pathlib import Path

from tulip_testbed.base.files import check_new, write_bytes
from tulip_testbed.experiments.discovery_record import DiscoveryRecord
from tulip_testbed.experiments.montecarlo.montecarlo_result import MonteCarlo
from tulip_testbed.experiments.records import Record
from tulip_testbed.pages import ENDING
from tulip_testbed.pages.discovery_page import discovery_page
from tulip_testbed.pages.page import Page, html, montecarlo_page, validation_page


def page_of(run: Record) -> Page:
    """Make the page of a run of any kind."""
    if isinstance(run, DiscoveryRecord):
        return discovery_page(run)
    return montecarlo_page(run) if isinstance(run, MonteCarlo) else validation_page(run)


def write_page(path: Path, run: Record) -> Page:
    """Write the page of a run as one HTML file, which appears whole.

    Returns:
        the page; its `missing` lists the pictures that could not be drawn.

    Raises:
        InputError: the file exists, cannot be written or has another ending.
    """
    check_new(path, ENDING)
    page = page_of(run)
    write_bytes(path, html(page).encode(), new=True)
    return page

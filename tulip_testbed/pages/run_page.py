"""The page of any run."""

from __future__ import annotations

from pathlib import Path

from tulip_testbed.base.files import check_new, write_bytes
from tulip_testbed.experiments.discovery_result import Discovered
from tulip_testbed.experiments.predict import Prediction
from tulip_testbed.experiments.saved_runs import RunResult
from tulip_testbed.experiments.validation_result import Validation
from tulip_testbed.pages import ENDING
from tulip_testbed.pages.discovery_page import discovery_page
from tulip_testbed.pages.montecarlo_page import montecarlo_page
from tulip_testbed.pages.page import Page, html
from tulip_testbed.pages.prediction_page import prediction_page
from tulip_testbed.pages.validation_page import validation_page


def page_of(run: RunResult | Prediction) -> Page:
    """Make the page of a prediction or of a run of any kind."""
    if isinstance(run, Prediction):
        return prediction_page(run)
    if isinstance(run, Discovered):
        return discovery_page(run)
    return validation_page(run) if isinstance(run, Validation) else montecarlo_page(run)


def write_page(path: Path, run: RunResult | Prediction) -> Page:
    """Write the page of a prediction or a run as one HTML file, which appears whole.

    Returns:
        the page; its `missing` lists the pictures that could not be drawn.

    Raises:
        InputError: the file exists, cannot be written or has another ending.
    """
    check_new(path, ENDING)
    page = page_of(run)
    write_bytes(path, html(page).encode(), new=True)
    return page

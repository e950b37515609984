"""The page of a prediction."""

from __future__ import annotations

from tulip_testbed.base.table import Table
from tulip_testbed.experiments.predict import Prediction
from tulip_testbed.pages.figures import error_bars
from tulip_testbed.pages.page import Page, Section


def prediction_page(found: Prediction) -> Page:
    """Make the page of a prediction: how far every model is off on postures that took no part."""
    shown = found.tables()
    tables = tuple(one for one in shown if isinstance(one, Table))
    notes = tuple(one for one in shown if isinstance(one, str) and one != found.verdict)
    models = list(dict.fromkeys(one.name for one in found.models))
    figures = []
    for split in dict.fromkeys(one.split for one in found.models):
        of_split = [one for one in found.models if one.split == split]
        rows: dict[str, dict[str, tuple[float, tuple[float | None, float | None]]]] = {}
        for axis in "xy":
            ends = [(getattr(one.low95, axis, None), getattr(one.high95, axis, None)) for one in of_split]
            values = [getattr(one.rms_mm, axis) for one in of_split]
            rows[axis] = dict(
                zip((one.name for one in of_split), zip(values, ends, strict=True), strict=True)
            )
        figures.append(error_bars(split, rows))
    facts = (("models", str(len(models))), ("splits", ", ".join(one.name for one in figures)))
    sections = (
        Section("Errors of the models", figures=tuple(figures)),
        Section(tables[0].title, notes, tables),
    )
    return Page("Prediction of the centre of pressure", "", found.verdict, facts, sections)

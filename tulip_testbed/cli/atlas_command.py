"""`tulip atlas`."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from tulip_testbed.cli.options import Json, Plan, Preset, RobotFile, Seed
from tulip_testbed.effects.targets import PLACEMENTS
from tulip_testbed.experiments.atlas.effect_atlas import Atlas, Row, atlas, document
from tulip_testbed.experiments.atlas.isolability import ISOLABLE, order
from tulip_testbed.experiments.atlas.planned_experiment import planned
from tulip_testbed.experiments.description import described_robot
from tulip_testbed.experiments.laboratory import DEFAULT_SEED
from tulip_testbed.experiments.terminal import ERR, console, finite, print_json, print_table
from tulip_testbed.experiments.usable_plan import DEFAULT_PLAN, check_plan, plan_for
from tulip_testbed.identification.residual_channels import CHANNELS
from tulip_testbed.sim.errors import at_least
from tulip_testbed.sim.files import check_new, new_folder, write_text
from tulip_testbed.sim.measurements.table_files import write_json
from tulip_testbed.sim.robot import TULIP

LEGEND = (
    "found: least size that is found with 90 % probability, by all channels, and by one alone (A centre of "
    "pressure, F sum of the cells, T twist of the plates, C closure of the legs); -: never. "
    "Bias of the parameter that suffers most if nobody models the effect [standard errors of the default "
    "estimator], at the plausible size (1 s.d. of its prior) and at the least size found. "
    "like: the angle to what it looks most like [deg]."
)

ABSORBED = (
    "Effects that are absorbed: at plausible sizes they cannot be seen with these postures and channels"
)


def atlas_command(
    plan: Plan = None,
    /,
    *,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help="write atlas.json, bias.csv and a heat map")
    ] = None,
    preset: Preset = "wii",
    seed: Seed = DEFAULT_SEED,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Before any data: which effects a plan would show, which it could not tell apart, which it would hide.

    Example: tulip atlas --preset force-plate --out atlas
    """
    if out is not None:
        check_new(out)
    at_least("seed", seed, 0)
    described = described_robot(robot)
    made = plan_for(described, plan)
    check_plan(described, made, str(plan or DEFAULT_PLAN))
    with ERR.status("solving the plan and looking at every effect"):
        found = atlas(planned(made, preset, described, seed), np.random.default_rng(seed))
    said = {"preset": preset, "seed": seed, **document(found)}
    if out is not None:
        with new_folder(out) as working:
            write_json(working / "atlas.json", finite(said))
            write_text(working / "bias.csv", biases(found))
            write_text(working / "separation.html", separation(found, preset))
    if as_json:
        print_json(said)
    else:
        print_atlas(console(), found)
    if out is not None:
        ERR.print(f"Atlas: {out}")
    return 0


def biases(found: Atlas) -> str:
    """Bias of every parameter by every effect at its plausible size, as CSV [mm] and [standard errors]."""
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


def separation(found: Atlas, preset: str) -> str:
    """Heat map of the angles, one placement standing for all."""
    from tulip_testbed.pages.heat_map_figures import heat_map  # plotly takes half a second

    kept = _once(found)
    chosen = [kept[k] for k in order(found.angle[np.ix_(kept, kept)])]
    degrees = np.degrees(found.angle[np.ix_(chosen, chosen)])
    bound = float(np.degrees(ISOLABLE))
    title = f"Angle between effects, preset {preset}: below {bound:.0f} deg (brown) they cannot be told apart"
    return heat_map(degrees, [found.shown[k].label for k in chosen], title, "deg", 90.0, bound)


def _once(found: Atlas) -> list[int]:
    """Numbers of the candidates, of those that concern one placement the first alone."""
    placed = [k for k, c in enumerate(found.shown) if c.effect.targets is PLACEMENTS]
    return [k for k in range(len(found.shown)) if k not in placed[1:]]


def print_atlas(screen: Console, found: Atlas) -> None:
    """Three tables: what is observed, what looks alike, what is absorbed."""
    planned = found.planned
    screen.print(
        f"{len(planned.observed)} of {len(planned.plan)} postures can be measured; the catalogue is worth "
        f"{found.tests:.0f} independent tests, each at the level {found.level:.1e}."
    )
    print_table(screen, _table(found, [row for row in _rows(found) if row.visible], "Effects that are seen"))
    hidden = [row for row in _rows(found) if not row.visible]
    if hidden:
        print_table(screen, _table(found, hidden, ABSORBED))
    screen.print(LEGEND, markup=False, highlight=False)
    if found.groups:
        screen.print(f"Cannot be told apart (any two closer than {np.degrees(ISOLABLE):.0f} deg):")
        for group in found.groups:
            screen.print(f"  {', '.join(found.shown[k].label for k in group)}", highlight=False)
    near = [found.nearest(k)[1] for k in range(len(found.shown))] if len(found.shown) > 1 else []
    screen.print(f"{sum(angle >= ISOLABLE for angle in near)} of {len(found.shown)} seen ones are isolable.")


def _rows(found: Atlas) -> list[Row]:
    """Of those that concern one placement, the one that is hardest to see."""
    out, worst = [], {}
    for row in found.rows:
        if row.candidate.effect.targets is not PLACEMENTS:
            out.append(row)
            continue
        key = (row.candidate.effect.name, row.size)
        if key not in worst or row.detectable > worst[key].detectable:
            worst[key] = row
    return out + list(worst.values())


def _table(found: Atlas, rows: list[Row], title: str) -> Table:
    table = Table(title=title, title_justify="left", header_style="bold", padding=(0, 1, 0, 0), box=None)
    table.add_column("effect", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for header in ("plausible", "found", *CHANNELS, "bias, plausible", "bias, found"):
        table.add_column(header, justify="right", no_wrap=True)
    observed = any(row.visible for row in rows)
    if observed:
        table.add_column("like", no_wrap=True)
    number = {id(candidate): k for k, candidate in enumerate(found.shown)}
    errors = found.planned.standard_errors
    for row in rows:
        at = number.get(id(row.candidate))
        table.add_row(
            f"{row.candidate.label} {row.name}".strip(),
            _scale(row)[1],
            _size(row, row.prior),
            _size(row, row.detectable),
            *(_size(row, row.by_channel[c]) for c in CHANNELS),
            _worst(row.bias / errors),
            _worst(row.bias_undetected / errors),
            *([_like(found, at)] if observed else []),
        )
    for column in table.columns:  # figures are not cut
        column.min_width = max(len(str(cell)) for cell in [column.header, *column.cells])
    return table


def _like(found: Atlas, number: int | None) -> str:
    if number is None or len(found.shown) < 2:
        return ""
    other, angle = found.nearest(number)
    return f"{np.degrees(angle):2.0f} {found.shown[other].label}"


def _scale(row: Row) -> tuple[float, str]:
    """Return the factor from SI units and the unit in which a size is shown."""
    return row.parameter.display if row.parameter else (1.0, "")


def _size(row: Row, value: float) -> str:
    if not np.isfinite(value):
        return "-"
    if row.size is None:
        return "yes"
    size = _scale(row)[0] * value
    return f"{size:.0f}" if size >= 10 else f"{size:.2g}"


def _worst(bias: np.ndarray) -> str:
    """The largest bias with its parameter's number."""
    if not np.isfinite(bias).all():
        return "-"
    k = int(np.abs(bias).argmax())
    return f"{bias[k]:+.2f} ({k + 1})" if abs(bias[k]) >= 0.005 else "0"

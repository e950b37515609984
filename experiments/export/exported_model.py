"""What `tulip export` tells: what changed in the links, how much of it is data, which files were written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tulip_testbed.base.column import Column
from tulip_testbed.base.numbers import number
from tulip_testbed.base.table import Cell, Shown, Table
from tulip_testbed.identification.consistent_robot import ConsistentRobot
from tulip_testbed.identification.pseudo_inertia import central, standard_of


@dataclass(frozen=True, eq=False, repr=False)
class ExportedModel(Shown):
    """A consistent robot and the files that hold it.

    Attributes:
        links: names, (n,).
        cad: CAD's pseudo-inertias, (n, 4, 4).
        robot: the exported one.
        shares: data share of mass and centre, (n, 4), see `consistent_robot.data_shares`.
        mass: total mass [kg]. mass_source: where it comes from.
        files: that were written, the model first.
        notes: sentences on what the user has to know.
    """

    links: tuple[str, ...]
    cad: np.ndarray
    robot: ConsistentRobot
    shares: np.ndarray
    mass: float
    mass_source: str
    files: tuple[Path, ...]
    notes: tuple[str, ...]

    def plain(self) -> dict[str, Any]:
        """Return the JSON document."""
        return {
            "links": [self._link(k) for k in range(len(self.links))],
            "misfit_in_standard_errors": self.robot.misfit,
            "total_mass": {"value": self.mass, "source": self.mass_source},
            "files": [str(path) for path in self.files],
            "notes": list(self.notes),
        }

    def _link(self, k: int) -> dict[str, Any]:
        found, before = (_figures(one[k]) for one in (self.robot.pseudo, self.cad))
        return {
            "link": self.links[k],
            "mass": found["mass"],
            "mass_cad": before["mass"],
            "mass_data_share": float(self.shares[k, 0]),
            "center": found["center"],
            "center_cad": before["center"],
            "center_data_share": self.shares[k, 1:].tolist(),
            "inertia": found["inertia"],
            "inertia_cad": before["inertia"],
        }

    def table(self) -> Table:
        """Return what changed in every link."""
        columns = [
            Column("link"),
            Column("mass, CAD", "kg", ".3f"),
            Column("mass", "kg", ".3f"),
            Column("mass from data", "%", ".0f", 100),
        ]
        for axis in "xyz":
            columns += [
                Column(f"{axis}, CAD", "mm", ".1f", 1e3, extra=True),
                Column(axis, "mm", ".1f", 1e3),
                Column(f"{axis} from data", "%", ".0f", 100, extra=True),
            ]
        rows = []
        for k, row in enumerate(self.plain()["links"]):
            cells = [Cell(row[name], f"links.{k}.{name}") for name in ("mass_cad", "mass", "mass_data_share")]
            of_center = zip(row["center_cad"], row["center"], row["center_data_share"], strict=True)
            rows.append([row["link"], *cells, *(value for axis in of_center for value in axis)])
        note = (
            "From data: 100 %: base parameters and total mass determine the number; 0 %: it is what CAD "
            "makes likely. Inertias follow mass and centre; statics cannot determine them."
        )
        return Table("Masses and centres of mass of the links", tuple(columns), rows, note)

    def parts(self) -> list[Table | str]:
        """Return the table, the total mass, the misfit and the files."""
        return [
            self.table(),
            f"Total mass: {number(self.mass, '.3f')} kg, {self.mass_source}.",
            self.misfit_line,
            *self.notes,
            *(f"Written: {path}" for path in self.files),
        ]

    @property
    def misfit_line(self) -> str:
        """Say how the base parameters of the file stand to the estimate."""
        if not self.robot.misfit:
            return "The base parameters of the exported robot are those of the estimate."
        return (
            "No physically consistent robot has the estimated base parameters; the exported one is the "
            f"nearest, {number(self.robot.misfit, '.3g')} standard errors away (in the metric of their "
            "covariance)."
        )


def _figures(pseudo: np.ndarray) -> dict[str, Any]:
    """Return mass [kg], centre [m] and inertia about it [kg m2] for JSON; zeros without mass."""
    if not standard_of(pseudo)[0] > 0:
        return {"mass": 0.0, "center": [0.0] * 3, "inertia": np.zeros((3, 3)).tolist()}
    mass, center, inertia = central(pseudo)
    return {"mass": mass, "center": center.tolist(), "inertia": inertia.tolist()}

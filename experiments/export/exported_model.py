"""What `tulip export` tells: what changed in the links, how much of it is data, which file was written."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tulip_testbed.base.numbers import number
from tulip_testbed.base.result import Array, Result
from tulip_testbed.base.table import Table
from tulip_testbed.experiments.parameter_tables import ConstantError
from tulip_testbed.identification.cad_prior import CENTER_SD, MASS_SD
from tulip_testbed.identification.pseudo_inertia import central, standard_of


@dataclass(frozen=True)
class ExportedLink:
    """A link before (CAD) and after.

    Attributes:
        mass, mass_cad: [kg]. center, center_cad: (3,) [m] in the link's frame.
        inertia, inertia_cad: about the centre, (3, 3) [kg m2].
        mass_data_share, center_data_share: how much of it is data, see `consistent_robot.data_shares`; (3,).
    """

    link: str
    mass: float
    mass_cad: float
    mass_data_share: float
    center: Array
    center_cad: Array
    center_data_share: Array
    inertia: Array
    inertia_cad: Array


@dataclass(frozen=True)
class TotalMass:
    """The total mass [kg] and where it comes from."""

    value: float
    source: str


@dataclass(frozen=True, eq=False, repr=False)
class ExportedModel(Result):
    """A consistent robot and the file that holds it.

    Attributes:
        links: before and after. base_parameters: of the file, (p,) [m].
        constant: error of the centre of pressure on the data, which the file does not have.
        misfit_in_standard_errors: between the base parameters of the file and the estimate.
        file: that was written.
        notes: sentences on what the user has to know.
    """

    links: tuple[ExportedLink, ...]
    base_parameters: Array
    constant: ConstantError
    misfit_in_standard_errors: float
    total_mass: TotalMass
    file: str
    notes: tuple[str, ...]

    def tables(self) -> list[Table | str]:
        masses = ("mass, CAD", "kg", ".3f"), ("mass", "kg", ".3f"), ("mass from data", "%", ".0f", 100)
        heads = ("link", *masses)
        for axis in "xyz":
            cad = (f"{axis}, CAD", "mm", ".1f", 1e3, True)
            heads += (cad, (axis, "mm", ".1f", 1e3), (f"{axis} from data", "%", ".0f", 100, True))
        rows = []
        for link in self.links:
            of_mass = link.mass_cad, link.mass, link.mass_data_share
            of_center = zip(link.center_cad, link.center, link.center_data_share, strict=True)
            rows.append([link.link, *of_mass, *(float(value) for axis in of_center for value in axis)])
        note = (
            "From data: 100 %: base parameters and total mass determine the number; 0 %: CAD makes it "
            "likely, or its standard error exceeds what CAD leaves open. Inertias follow mass and centre "
            "where the data do not determine them; statics cannot."
        )
        return [
            Table("Masses and centres of mass of the links", heads, rows, note),
            f"Total mass: {number(self.total_mass.value, '.3f')} kg, {self.total_mass.source}.",
            str(self.constant),
            self.misfit_line,
            *self.notes,
            f"Written: {self.file}",
        ]

    @property
    def misfit_line(self) -> str:
        if not self.misfit_in_standard_errors:
            return "The base parameters of the exported robot are those of the estimate."
        return (
            f"The base parameters of the exported robot are {number(self.misfit_in_standard_errors, '.3g')} "
            "standard errors from those of the estimate (in the metric of their covariance): CAD is taken as "
            f"right within {100 * MASS_SD:.0f} % of each mass and {1e3 * CENTER_SD:.0f} mm of each centre."
        )


def exported_links(
    names: Sequence[str], cad: np.ndarray, pseudo: np.ndarray, shares: np.ndarray
) -> tuple[ExportedLink, ...]:
    """Describe links by pseudo-inertias before and after, (n, 4, 4), and the data's shares, (n, 4)."""
    links = []
    none = 0.0, np.zeros(3), np.zeros((3, 3))  # of a link without mass
    for name, *both, share in zip(names, pseudo, cad, shares, strict=True):
        now, before = (central(each) if standard_of(each)[0] > 0 else none for each in both)
        mass = now[0], before[0], float(share[0])
        links.append(ExportedLink(name, *mass, now[1], before[1], share[1:], now[2], before[2]))
    return tuple(links)

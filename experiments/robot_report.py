"""Report on a robot: its file, its needs in the laboratory, its standard and its base parameters."""

from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

from tulip_testbed.base.errors import listed
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.identification.base_parameters import BaseParameters, base_parameters, standard_parameters
from tulip_testbed.identification.link_clearances import overlaps_at_reference
from tulip_testbed.sim.robot import Robot
from tulip_testbed.sim.robot_check import RobotFinding, robot_findings


@dataclass(frozen=True)
class StandardParameters:
    """Standard parameters of a link (eq. 5): mass [kg] and first moments [kg m]."""

    link: str
    mass: float
    mcx: float
    mcy: float
    mcz: float


@dataclass(frozen=True)
class BaseParameter:
    """A base parameter.

    Attributes:
        value: of the model [m]. columns: of the regressor that it unites, as text.
        standard: its terms, as a sum of standard parameters. terms: their number.
        largest: the largest term. meaning: what is summed, in words.
    """

    number: int
    name: str
    value: float
    columns: str
    standard: str
    terms: int
    largest: str
    meaning: str


@dataclass(frozen=True, repr=False)
class RobotReport(Result):
    """Report on a robot.

    Attributes:
        name: of the robot. model: its MJCF file. support: of the base parameters.
        total_mass: [kg]. counts: of parameters: standard, columns, joined, base.
        standard, base: the parameters. findings: what it lacks for the laboratory.
        found, assumed, problems: what a published file says and does not, and what may go wrong.
        description: file that was written for the other commands; None: none was.
    """

    name: str
    model: str
    support: str
    total_mass: float
    counts: dict[str, int]
    standard: tuple[StandardParameters, ...]
    base: tuple[BaseParameter, ...]
    findings: tuple[RobotFinding, ...]
    found: dict[str, Any] | None = None
    assumed: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    description: str | None = None

    def tables(self) -> list[Table | str]:
        count = self.counts
        parts: list[Table | str] = [] if self.found is None else [_found_table(self.name, self.found)]
        moments = ((f"m c_{axis}", "kg m", ".4f") for axis in "xyz")
        of_links = ("link", ("mass", "kg", ".3f"), *moments)
        figures = ("value", "mm", ".2f", 1e3), ("terms", "", "d")
        of_base = (("no.", "", "d"), "parameter", *figures, "largest term", "sum of")
        rows = [[b.number, b.name, b.value, b.terms, b.largest, b.meaning] for b in self.base]
        base_title = f"Base parameters; the total mass is {self.total_mass:.3f} kg"
        note = "A base parameter is the sum over the total mass; --json holds every term."
        for title, lines in (("Assumed", self.assumed), ("Problems", self.problems)):
            if lines:
                parts += [f"{title}:", *(f"- {line}" for line in lines)]
        parts += [
            f"{self.model}: {count['standard']} standard parameters -> {count['columns']} columns -> "
            f"{count['joined']} -> {count['base']} base parameters in {self.support} support",
            "",
            Table("Standard parameters (eq. 5)", of_links, [[*astuple(link)] for link in self.standard]),
            Table(base_title, of_base, rows, note),
        ]
        if self.findings:
            heads = ("about", "found", "what goes wrong", "what is done")
            rows = [[f.name, f.found, f.consequence, f.assumed] for f in self.findings]
            parts.append(Table("Items that this robot lacks for the laboratory", heads, rows))
        return [*parts, *([f"Description: {self.description}"] if self.description else [])]


def report_robot(robot: Robot, support: str, problems: tuple[str, ...] = (), **more: Any) -> RobotReport:
    if found := overlaps_at_reference(robot):
        overlaps = listed(f"{' and '.join(names)} ({1e3 * d:.0f} mm)" for names, d in found.items())
        problems += (f"links that overlap in the posture stand, and may do so in plans: {overlaps}",)
    parameters = base_parameters(robot, robot.model, support)
    standard = standard_parameters(robot.model)
    values = parameters.values(standard)
    return RobotReport(
        name=robot.name,
        model=robot.model_file.name,
        support=support,
        total_mass=float(standard[:, 0].sum()),
        counts={
            "standard": standard.size,
            "columns": 3 * len(parameters.tree.frames),
            "joined": parameters.merged_columns,
            "base": len(parameters.names),
        },
        standard=tuple(
            StandardParameters(link, *row)
            for link, row in zip(parameters.tree.links, standard.tolist(), strict=True)
        ),
        base=tuple(
            _base_parameter(parameters, index, float(value), standard) for index, value in enumerate(values)
        ),
        findings=tuple(robot_findings(robot)),
        problems=problems,
        **more,
    )


def _found_table(name: str, found: dict[str, Any]) -> Table:
    length, width = np.ptp(np.array(found["soles"][0])[:, :2], axis=0)
    torque = sorted(found["torque"].values())
    rows = [
        ("links, joints", f"{found['links']}, {found['joints']}"),
        ("mass", f"{found['mass']:.2f} kg"),
        ("free body", found["root"]),
        ("stance foot (right), swing foot (left)", listed(found["feet"])),
        ("sole", f"{1e3 * length:.0f} mm long, {1e3 * width:.0f} mm wide"),
        ("leg, hip to sole", f"{found['leg']:.3f} m"),
        ("joints between the feet", str(len(found["between_feet"]))),
        ("other joints (arms, head)", str(len(found["others"]))),
        ("torque limits", f"{torque[0]:.3g} to {torque[-1]:.3g} Nm"),
        ("standing posture", f"free body {found['height']:.3f} m above the soles"),
    ]
    return Table(name, ("found", "value"), rows)


def _base_parameter(
    parameters: BaseParameters, index: int, value: float, standard: np.ndarray
) -> BaseParameter:
    """Describe a base parameter by the standard parameters, (n_links, 4) [kg, kg m, kg m, kg m]."""
    terms = parameters.terms(index)
    links = parameters.tree.links
    sizes = [
        abs(weight * standard[links.index(link), ("m", "mx", "my", "mz").index(quantity)])
        for weight, quantity, link in terms
    ]
    moments = [(name[1], of) for _, name, of in terms if name != "m"]
    lengths = sorted({round(1e3 * abs(weight), 1) for weight, name, _ in terms if name == "m"})
    masses = [of for _, name, of in terms if name == "m"]
    parts = []
    if moments:
        parts.append(f"{moments[0][0]} moment of {_listed([of for _, of in moments])}")
    if masses:
        at = " or ".join(f"{length:g}" for length in lengths)
        what = _listed(masses) if len(masses) == 1 else f"{len(masses)} masses"
        parts.append(f"{what} at {at} mm")
    weight, quantity, link = terms[int(np.argmax(sizes))]
    factor = "" if abs(abs(weight) - 1) < 1e-12 else f"{1e3 * abs(weight):.4g} mm "
    return BaseParameter(
        number=index + 1,
        name=parameters.names[index],
        value=value,
        columns=parameters.groups[index],
        standard=parameters.grouping(index),
        terms=len(terms),
        largest=f"{'-' if weight < 0 else ''}{factor}{quantity}[{link}]",
        meaning=", ".join(parts),
    )


def _listed(links: list[str]) -> str:
    return " + ".join(links) if len(links) < 3 else f"{len(links)} links from {links[0]}"

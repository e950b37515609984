"""Import a laboratory's own table: propose a mapping, write a measurement folder, check it with the robot."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pyarrow.csv

from tulip_testbed.base.errors import InputError, at_most, listed, look_up
from tulip_testbed.base.files import new_folder, read_bytes, sha256, write_bytes
from tulip_testbed.base.numbers import number
from tulip_testbed.base.result import Result
from tulip_testbed.base.table import Table
from tulip_testbed.base.table_files import MOST_ROWS, TableFile, software, write_json
from tulip_testbed.experiments.table_import.column_names import Proposal, propose, with_units
from tulip_testbed.experiments.table_import.import_map import ONE, ImportMap, SeriesOfMap, with_unknowns
from tulip_testbed.experiments.table_import.series_import import (
    added_columns,
    necessary,
    sampled,
    series_of,
    series_rows,
    without_gaps,
)
from tulip_testbed.experiments.table_import.sign_checks import SignCheck, check_signs
from tulip_testbed.identification.contact_readings import ASSUMED_FORCE, ASSUMED_MOMENT
from tulip_testbed.identification.conventions.audit_conventions import (
    audit_conventions,
    can_be_audited,
    convention_table,
)
from tulip_testbed.identification.conventions.log_conventions import WrenchConvention
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.measurements import Measurements, write_measurements
from tulip_testbed.measurements.cells import PLATES
from tulip_testbed.measurements.column_mapping import MappedTable, MappingEntry, check_mapping
from tulip_testbed.measurements.contact_entries import UNKNOWN, CopEntry, WrenchEntry
from tulip_testbed.measurements.contacts import POSE
from tulip_testbed.measurements.data import vertical_forces
from tulip_testbed.measurements.logs.log_file import read_log
from tulip_testbed.measurements.manifest import Manifest, manifest_from
from tulip_testbed.measurements.measurement_folder import known_columns, measurements_in, required_columns
from tulip_testbed.measurements.stated_convention import StatedConvention
from tulip_testbed.sim.robot import Robot, joint_names, sole_point

GRAVITY = 9.81  # m/s2
AS_WRITTEN = ("time", "window", "samples", "speed", "acceleration")  # exact names that others use too
NO_CONTACTS = (
    "contacts: not stated; state kind, mount, channels, zero and pose of both as [[contacts]], "
    "or the cells and heights of [plates] (docs/reference/measurements.md)"
)
LIFTED = 0.05  # of the weight, below which a foot may be in the air
SIGNED = ("q.", "wrench.", "cop.", "plate.", "motor.", "q_command.")  # columns with a sign begin with one


@dataclass(frozen=True)
class MappedColumn:
    """Source of a column of the contract.

    Attributes:
        column: of the table. unit: None: the contract's. sign: 1 or -1.
        by: how it was found. checked: what confirmed its sign; None: nothing.
    """

    column: str
    unit: str | None
    sign: int
    by: str
    checked: str | None


@dataclass(frozen=True, repr=False)
class ImportedTable(Result):
    """The result of importing a table.

    Attributes:
        mapped: by column of the contract.
        assumed: what neither the table nor the user says. problems: what the user has to decide or look at.
        unused: columns of the table that are not read.
        folder: the measurement folder; None if something necessary is missing.
        conventions: of the log, by the wrenches that the robot needs; empty without six-axis sensors in feet.
    """

    mapped: dict[str, MappedColumn]
    assumed: tuple[str, ...]
    problems: tuple[str, ...]
    unused: tuple[str, ...]
    folder: str | None
    conventions: tuple[StatedConvention, ...] = ()

    @property
    def exit_code(self) -> int:
        """Return 1 if there are problems, whether or not the folder was written, and else 0."""
        return int(bool(self.problems))

    def tables(self) -> list[Table | str]:
        heads = ("of the contract", "of the table", "unit", "sign", "found by", "sign checked by")
        rows = [
            [name, source.column, source.unit or "", f"{source.sign:+d}", source.by, source.checked or ""]
            for name, source in self.mapped.items()
        ]
        parts: list[Table | str] = [Table("Columns", heads, rows)]
        if self.unused:
            parts.append(f"Not read: {listed(self.unused)}")
        for title, lines in (("Assumed", self.assumed), ("Problems", self.problems)):
            if lines:
                parts += [f"{title}:", *(f"- {line}" for line in lines)]
        if self.conventions:
            parts.append(convention_table(self.conventions))
        if self.folder is None:
            return [*parts, "No folder was written; the problems say why."]
        return [*parts, f"Measurement folder: {self.folder}"]


def import_table(table: Path, robot: Robot, folder: Path, stated: ImportMap) -> ImportedTable:
    """Write a measurement folder with a laboratory's own table, see `tulip_testbed.import_table`."""
    stated = stated.model_copy(update={"columns": with_units(stated.columns)})
    return _Import(read_log(table), robot, stated).carried_out(Path(folder))


class _Import:
    """An import at work; a class because every step may assume something or find something missing."""

    def __init__(self, table: TableFile, robot: Robot, stated: ImportMap) -> None:
        self.table, self.robot, self.stated = table, robot, stated
        self.assumed: list[str] = []
        self.problems: list[str] = []
        self.missing: list[str] = []
        self.conventions: tuple[StatedConvention, ...] = ()
        self.convention = WrenchConvention()
        self.added: dict[str, np.ndarray] = {}  # columns that the table lacks
        self.series = series_of(table, stated)

    def carried_out(self, folder: Path) -> ImportedTable:
        """Map the table, write the folder if nothing is missing, and check the signs."""
        manifest, stated, series = self._manifest(), self.stated, self.series
        names = known_columns(manifest) if series is None else sampled(known_columns(manifest))
        joints = tuple(manifest.joints)
        contacts = stated.contacts is not None or stated.plates is not None
        if not contacts and any(name.startswith(("wrench.", "cop.")) for name in stated.columns):
            raise InputError(f"map: {NO_CONTACTS}")
        angles = [name for name in stated.columns if name.startswith("q.")]
        if len(angles) > 1 and not set(angles) & {f"q.{joint}" for joint in joints}:
            raise InputError(
                f"map: found {listed(angles, 3)}, none of them a joint of {self.robot.name}; "
                "give the robot that was measured as `robot`"
            )
        check_mapping(stated.columns, names, "map", "columns")
        for name, entry in stated.columns.items():
            look_up("column", entry.column, self.table.types, f"{self.table.path}: map of {name}")
        required = required_columns(joints, manifest.contacts, stated.constant_joints)
        if not contacts:
            names = tuple(name for name in names if not name.startswith(("cell", "plate.")))
            required = tuple(name for name in required if name in names)
            self.missing.append(NO_CONTACTS)
        if series is not None:
            required = necessary(required, series)
        proposal = propose(list(self.table.types), names, required, stated.columns)
        if proposal.silent:
            self.assumed.append(
                f"not used, since no unit is written in the name: {listed(map(repr, proposal.silent))}; "
                "state it to use one"
            )
        if series is None:
            self._complete(proposal)
        self._find_missing(proposal, required)
        signs = SignCheck({}, [])
        if not self.missing:
            signs = (
                self._written(proposal, manifest, folder)
                if series is None
                else self._reduced(proposal, manifest, series, folder, required)
            )
        mapped = {name: MappedColumn(name, None, 1, "name", signs.of(name)) for name in proposal.exact}
        for name, entry in proposal.mapping.items():
            by = "statement" if name in stated.columns else "words of the name"
            mapped[name] = MappedColumn(entry.column, entry.unit, entry.sign, by, signs.of(name))
        mapped |= {name: MappedColumn(name, None, 1, "added", None) for name in self.added}
        unchecked = [
            name
            for name, source in mapped.items()
            if name.startswith(SIGNED) and source.by != "statement" and not source.checked
        ]
        if unchecked:
            self.assumed.append(f"signs +1, which nothing here has checked: {listed(unchecked)}")
        return ImportedTable(
            mapped=mapped,
            assumed=tuple(self.assumed),
            problems=(*self.missing, *self.problems, *signs.doubtful),
            unused=tuple(proposal.unused),
            folder=None if self.missing else str(folder),
            conventions=self.conventions,
        )

    def _manifest(self) -> Manifest:
        """Return the manifest without its mapping; without contacts it is that of any plates."""
        stated, robot = self.stated, self.robot
        joints = joint_names(robot.model)
        for joint in stated.constant_joints:
            look_up("joint", joint, joints, "map: key 'constant_joints'")
        if stated.contacts is not None and stated.plates is not None:
            raise InputError("map: found 'contacts' and 'plates', expected one of them")
        entries = stated.contacts or []
        wrenches = [entry for entry in entries if isinstance(entry, WrenchEntry)]
        assumed = {
            f"gravity {GRAVITY:g} m/s2": stated.gravity is None,
            "the weighed mass is unknown": stated.weighed_mass is None,
            "the contact sensors' `covariance` is unknown: every averaged reading is taken to err by "
            f"{ASSUMED_FORCE:g} N or {ASSUMED_MOMENT:g} Nm (1 s.d.)": any(
                entry.covariance is None for entry in wrenches
            ),
            "the contact sensors' `zero` is unknown: a foot in the air shows it, and how far off the "
            "other's may be; if they were tared, state the s.d. of what that left of every channel, such as "
            "`zero = [2, 2, 2, 0.1, 0.1, 0.1]` [N, Nm]": any(entry.zero == UNKNOWN for entry in wrenches),
            "the `sd` of the centres of pressure is unknown: their forces are taken to err by "
            f"{ASSUMED_FORCE:g} N and the moments by {ASSUMED_MOMENT:g} Nm (1 s.d.)": any(
                isinstance(entry, CopEntry) and entry.sd is None for entry in entries
            ),
            "no `below` is stated: the foot is assumed to have no mass below its sensor, as in a sole; "
            "an ankle's sensor does not weigh the foot, whose mass and centre it needs": any(
                entry.mount == "foot" and entry.below is None for entry in wrenches
            ),
        }
        self.assumed += [text for text, holds in assumed.items() if holds]
        plain = stated.model_dump(mode="json", exclude_none=True)
        corners = {"front_left": [1, 1], "front_right": [1, -1], "rear_right": [-1, -1], "rear_left": [-1, 1]}
        nothing = {side: {"cells": corners, "top_height": 0.0} for side in ("right", "left")}
        contacts = [with_unknowns(entry) for entry in plain.get("contacts", [])]
        unknown = [entry for entry in contacts if entry["mount"] == "foot" and "pose" not in entry]
        for entry in unknown:
            sole = sole_point(robot.model, robot.feet[PLATES.index(entry["name"])]).tolist()
            entry["pose"] = dict.fromkeys(POSE, 0.0) | dict(zip("xyz", sole, strict=True))
        if unknown:
            advice = "; if nobody knows the place, state `tolerances = {wrench-origin = 0.05}` in the map"
            self.assumed.append(
                f"the `pose` of the contact sensors {listed(entry['name'] for entry in unknown)} is not "
                "stated: wrenches are taken to be in the sole below the ankle, in the axes of the foot"
                + ("" if "wrench-origin" in (stated.tolerances or {}) else advice)
            )
        return manifest_from(
            {
                "format": "tulip-measurements",
                "version": 2 if contacts else 1,
                "robot": {
                    "model": robot.model_file.name,
                    "sha256": robot.model_hash,
                    "stance_foot": robot.stance_foot,
                    "swing_foot": robot.swing_foot,
                },
                "joints": list(joints),
                **({"contacts": contacts} if contacts else {"plates": plain.get("plates", nothing)}),
                "weighed_mass": plain.get("weighed_mass"),
                "gravity": plain.get("gravity", GRAVITY),
                "sensors": stated.sensors.model_dump(),
                **{key: plain[key] for key in ("gains", "tolerances", "constant_joints") if plain.get(key)},
            }
        )

    def _complete(self, proposal: Proposal) -> None:
        """Add numbers of postures and placements, and say what the support and plain names stand for."""
        has = {*proposal.mapping, *proposal.exact}
        self.assumed += [
            f"column '{name}' is the contract's `{name}`, in its unit"
            for name in AS_WRITTEN
            if name in proposal.exact
        ]
        if "posture" not in has:
            self.added["posture"] = np.arange(1, len(self.table) + 1)
            self.assumed.append("postures are numbered by row: none was measured twice")
        if "placement" not in has:
            poses, how = [name for name in has if name.startswith("plate.")], self.stated.placement
            numbers = np.ones(len(self.table), int) if how == ONE else np.arange(1, len(self.table) + 1)
            if how is None and poses:
                entries = proposal.mapping
                columns = [entries[name].column if name in entries else name for name in poses]
                values = np.column_stack([self.table.numbers(column) for column in columns])
                self.assumed.append("a new placement begins where a plate's recorded pose changes")
                numbers = 1 + np.cumsum(np.append(False, (values[1:] != values[:-1]).any(axis=1)))
            elif how is None:
                self.assumed.append(
                    "every row is a placement of its own, as if the feet were moved between any two; state "
                    f"placement = '{ONE}' if they stayed"
                )
            self.added["placement"] = numbers
        if "support" not in has:
            self.assumed.append("both feet carry the robot in all rows (support 'double')")

    def _find_missing(self, proposal: Proposal, required: tuple[str, ...]) -> None:
        """Tell the necessary columns that the table lacks from the doubtful ones."""
        has = {*proposal.mapping, *proposal.exact, *self.added}
        lacks = [name for name in required if name not in has]
        undecided = {text.partition(":")[0]: text for text in proposal.undecided}
        nowhere = [name for name in lacks if name not in undecided]
        if angles := [name for name in nowhere if name.startswith("q.")]:
            entry = f'"{angles[0]}" = {{column = "..."}}'
            self.missing.append(
                f"no column for {listed(angles)}; state one below [columns] of the map, such as {entry}, "
                "or a constant in [constant_joints]"
            )
        if others := [name for name in nowhere if not name.startswith("q.")]:
            self.missing.append(f"no column for {listed(others)}; state one")
        for name, text in undecided.items():
            (self.missing if name in lacks else self.problems).append(text)

    def _written(self, proposal: Proposal, manifest: Manifest, folder: Path) -> SignCheck:
        """Read the table as everybody will, write the folder, and hold it against the robot."""
        table, mapping = self.table.with_columns(self.added), proposal.mapping
        try:
            at_most(f"{table.path}: rows", len(table), MOST_ROWS)
            mapped = manifest.model_copy(update={"mapping": mapping})
            read = measurements_in(mapped, table, Path("map"))
        except InputError as error:
            named = [name for name in mapping if f"'{name}'" in str(error)]
            columns = (f"; {name} is column '{mapping[name].column}'" for name in named)
            self.missing.append("".join([str(error), *columns]))
            return SignCheck({}, [])
        measurements = self._audited(read)
        if measurements.wrenches is read.wrenches:
            self._write_own(table, mapping, manifest, folder)
        else:  # the table is not what the contract expects
            write_measurements(folder, measurements)
        loads = vertical_forces(measurements)
        share = np.nan_to_num(loads / loads.sum(axis=1, keepdims=True))
        light = (share < LIFTED).any(axis=1) & (measurements.support == "double")
        if light.any():
            self.problems.append(
                f"support: in row {int(light.argmax()) + 1} one foot carries less than {100 * LIFTED:.0f} % "
                "of the weight, though both are said to stand; state a column 'support'"
            )
        later = np.diff(measurements.time)
        if (later < 0).any():
            row = int((later < 0).argmax())
            self.problems.append(
                f"time: row {row + 2} is {number(-later[row], '.3g')} s earlier than row {row + 1}, expected "
                "rows in the order in which they were measured"
            )
        return check_signs(measurements, nominal_robot(self.robot))

    def _write_own(
        self, table: TableFile, mapping: dict[str, MappingEntry], manifest: Manifest, folder: Path
    ) -> None:
        """Write a folder with the table as it is, unless columns were added, and its mapping."""
        source = self.table.path
        with new_folder(folder) as working:
            place = working / "postures.csv"
            if self.added or source.suffix not in (".csv", ".parquet"):
                pyarrow.csv.write_csv(table.table, place)
            else:
                place = place.with_suffix(source.suffix)
                write_bytes(place, read_bytes(source))
            entries = {name: entry.model_dump(exclude_none=True) for name, entry in mapping.items()}
            content = manifest.model_dump(exclude_unset=True) | ({"mapping": entries} if entries else {})
            content |= {"software": software(), "tables": {place.name: sha256(place)}}
            if self.conventions:
                content["conventions"] = [asdict(one) for one in self.conventions]
            write_json(working / "manifest.json", content)

    def _audited(self, measurements: Measurements) -> Measurements:
        """Audit the conventions, and return measurements with wrenches as the contract has them."""
        if not can_be_audited(measurements):
            return measurements
        found = audit_conventions(measurements, nominal_robot(self.robot))
        self.conventions, self.convention = found.stated, found.convention
        self.problems += found.problems
        self.assumed += [found.doubt] if found.doubt and found.doubt not in found.problems else []
        return found.applied

    def _reduced(
        self,
        proposal: Proposal,
        manifest: Manifest,
        series: SeriesOfMap,
        folder: Path,
        required: Sequence[str],
    ) -> SignCheck:
        """Reduce the samples of a series, settle its conventions, write the folder, check the signs."""
        nominal, mapping = nominal_robot(self.robot), proposal.mapping
        table = self.table.with_columns(added_columns(len(self.table), series))
        # The readings of a foot in the air may be absent.
        always = [name for name in required if series.support or name == "time" or name.startswith("q.")]
        sources = [mapping[name].column if name in mapping else name for name in always]
        table, left_out = without_gaps(table, sources)
        self.assumed += left_out
        mapped = MappedTable(table, mapping, manifest.gravity)
        try:
            rows, assumed, problems = series_rows(mapped, manifest, nominal, series, self.stated)
            measurements = self._audited(rows)
            if self.convention != WrenchConvention():  # a mean in axes that turn is no wrench in any axes
                turned, *_ = series_rows(mapped, manifest, nominal, series, self.stated, self.convention)
                measurements = replace(turned, conventions=measurements.conventions)
            write_measurements(folder, measurements)
        except InputError as error:
            self.missing.append(str(error))
            return SignCheck({}, [])
        self.assumed += assumed
        self.problems += problems
        return check_signs(measurements, nominal)

"""The user's statements about an imported table: a TOML file, or entries NAME=COLUMN:UNIT:SIGN."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tulip_testbed.base.errors import InputError, shortened
from tulip_testbed.base.files import read_toml
from tulip_testbed.base.validation_message import validation_message
from tulip_testbed.measurements.bounds import Deviation, Gain, Gravity
from tulip_testbed.measurements.column_mapping import MappingEntry
from tulip_testbed.measurements.contact_entries import UNKNOWN, UNKNOWN_POSE, Pair
from tulip_testbed.measurements.contacts import WRENCH
from tulip_testbed.measurements.manifest import ConstantEntry, MassEntry, PlatesEntry

ENDING = ".toml"
ONE = "one"  # placement of all rows


class SensorsOfMap(BaseModel):
    """Figures of the data sheets; what is left out is unknown."""

    model_config = ConfigDict(extra="forbid")
    encoder_sd: Deviation | None = None
    encoder_resolution: Deviation | None = None
    cell_sd: Deviation | None = None
    cell_resolution: Deviation | None = None
    placement_sd: tuple[Deviation, Deviation, Deviation] | None = None


class SeriesOfMap(BaseModel):
    """How a log of a moving robot is reduced to rows.

    Attributes:
        window, step: length of a row's window (by the encoders' resolution if left out), and from one to the
            next (half of it if left out) [s].
        rate: of a log without a time [Hz].
        support: of all rows; None: by a column, or by the contact sensors.
    """

    model_config = ConfigDict(extra="forbid")
    window: Annotated[float, Field(ge=0.1, le=1.0)] | None = None
    step: Annotated[float, Field(ge=0.01, le=60)] | None = None
    rate: Annotated[float, Field(ge=20, le=1e5)] | None = None
    support: Literal["double", "right", "left"] | None = None


class ValuesOfMap(BaseModel):
    """Values of a device or a matrix by their order, columns NAME.1, ...; their unit is of all or of each."""

    model_config = ConfigDict(extra="forbid")
    names: list[str]
    unit: str | list[str]

    def columns(self, device: str) -> dict[str, MappingEntry]:
        """Return the mapping of a device's values; more or fewer units than values are refused."""
        units = [self.unit] * len(self.names) if isinstance(self.unit, str) else self.unit
        if len(units) != len(self.names):
            raise InputError(
                f"map: key 'values.{device}.unit': found {len(units)}, expected one, or {len(self.names)}"
            )
        each = enumerate(zip(self.names, units, strict=True), start=1)
        return {name: MappingEntry(column=f"{device}.{k}", unit=unit) for k, (name, unit) in each}


class ImportMap(BaseModel):
    """Everything that a table does not say itself."""

    model_config = ConfigDict(extra="forbid")
    columns: dict[str, MappingEntry] = {}
    values: dict[str, ValuesOfMap] = {}
    contacts: Pair | None = None
    plates: PlatesEntry | None = None
    constant_joints: dict[str, ConstantEntry] = {}
    placement: Literal["each row", "one"] | None = None
    gravity: Gravity | None = None
    weighed_mass: MassEntry | None = None
    sensors: SensorsOfMap = SensorsOfMap()
    gains: dict[str, Gain] | None = None
    tolerances: dict[str, Deviation] | None = None
    series: SeriesOfMap | None = None


def read_map(stated: Sequence[str] | Path) -> ImportMap:
    """Read what the user states.

    Args:
        stated: a TOML file, or texts, of which one may be the path of a TOML file (*.toml) and the others are
            NAME=COLUMN, NAME=COLUMN:UNIT or NAME=COLUMN:UNIT:SIGN.
    """
    texts = [str(stated)] if isinstance(stated, Path) else list(stated)
    files = [text for text in texts if text.endswith(ENDING) and "=" not in text]
    if len(files) > 1:
        raise InputError(f"map: found files {files[0]} and {files[1]}, expected one at most")
    content = read_toml(Path(files[0])) if files else {}
    columns = content.get("columns", {})
    entries = dict(each := [_entry(text) for text in texts if text not in files])
    if twice := [name for k, (name, _) in enumerate(each) if name in dict(each[:k])]:
        raise InputError(f"map: {twice[0]}: found two columns, expected one")
    if isinstance(columns, dict):
        content["columns"] = columns | entries
    if isinstance(contacts := content.get("contacts"), list):
        content["contacts"] = [with_unknowns(one) for one in contacts]
    try:
        found = ImportMap.model_validate(content, context={UNKNOWN_POSE: True})
    except ValidationError as error:
        raise InputError(f"{files[0] if files else 'map'}: {validation_message(error)}") from None
    every = [one.columns(device) for device, one in found.values.items()]
    columns = {name: entry for one in every for name, entry in one.items()} | found.columns
    return found.model_copy(update={"columns": columns})


def with_unknowns(contact: Any) -> Any:
    """Return a contact with what a manifest does not leave out, and null, which TOML does not have."""
    if not isinstance(contact, dict):
        return contact
    if "foot" in contact and "name" not in contact:
        contact = {("name" if key == "foot" else key): value for key, value in contact.items()}
    wrench = {"channels": list(WRENCH), "covariance": None, "zero": UNKNOWN}
    unknown = {"wrench": wrench, "cop": {"sd": None}}.get(str(contact.get("kind")), {})
    return unknown | contact


def _entry(text: str) -> tuple[str, dict[str, Any]]:
    """Read NAME=COLUMN:UNIT:SIGN; a column may hold colons if unit and sign follow it."""
    name, equals, rest = text.partition("=")
    parts = rest.rsplit(":", 2)
    sign = 1
    if len(parts) > 1 and parts[-1].strip() in ("1", "+1", "-1"):
        sign = int(parts.pop())
    column, unit = (parts[0], parts[1]) if len(parts) == 2 else (":".join(parts), "")
    if not equals or not name.strip() or not column.strip():
        raise InputError(
            f"map: found '{shortened(text)}', expected a file *{ENDING} or NAME=COLUMN:UNIT:SIGN, "
            "such as q.right_knee=RKnee:deg:-1"
        )
    return name.strip(), {"column": column.strip(), "unit": unit.strip() or None, "sign": sign}

"""The contact sensors in the manifest of a measurement folder, version 2."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    ValidationInfo,
    model_validator,
)

from tulip_testbed.base.errors import shortened
from tulip_testbed.measurements.bounds import (
    LEAST_CELL_SPREAD,
    LEAST_DEVIATION,
    MOST_FORCE,
    Angle,
    Deviation,
    Length,
    Point,
)
from tulip_testbed.measurements.cells import CORNERS, PLATES
from tulip_testbed.measurements.contacts import CHANNEL_SETS, POSE, VERTICAL, Contacts
from tulip_testbed.measurements.data import wrong_arrays

LEAST_CELLS = 3  # a plane has no fewer
SAME = 1e-9  # relative, of a covariance and its transpose
UNKNOWN, TARED = "unknown", "tared"
UNKNOWN_POSE = "unknown pose"  # context of a validation that accepts a sensor in a foot without its pose
Load = Annotated[float, Strict(), Field(ge=0, le=MOST_FORCE, allow_inf_nan=False)]


def _zero(value: Any) -> Any:
    if value in (TARED, UNKNOWN) if isinstance(value, str) else False:
        return value
    if not isinstance(value, list) or not all(_is_deviation(one) for one in value):
        raise ValueError(f"expected '{TARED}', '{UNKNOWN}' or a list of s.d., one a channel (null: unknown)")
    return value


def _is_deviation(value: Any) -> bool:
    if value is None or isinstance(value, bool) or not isinstance(value, int | float):
        return value is None
    return value == 0 or LEAST_DEVIATION <= value <= MOST_FORCE


def _center_sd(value: Any) -> Any:
    every = value if isinstance(value, list) else [value]
    if len(every) not in (1, 3) or any(one is None or not _is_deviation(one) for one in every):
        raise ValueError("expected an s.d. [m], or a list of three")
    return value


def _covariance(rows: list[list[float]]) -> list[list[float]]:
    if any(len(row) != len(rows) for row in rows):
        raise ValueError("expected as many columns as rows")
    matrix = np.array(rows)
    if not np.allclose(matrix, matrix.T, rtol=SAME, atol=SAME * np.abs(matrix).max(initial=0.0)):
        raise ValueError("expected a symmetric matrix")
    scale = np.sqrt(np.maximum(np.diag(matrix), LEAST_DEVIATION**2))
    if rows and np.linalg.eigvalsh(matrix / scale / scale[:, None]).min() < -SAME * len(rows):
        raise ValueError("expected a covariance (none of its eigenvalues below zero)")
    return rows


def _spread_out(cells: dict[str, Point]) -> dict[str, Point]:
    places = np.array(list(cells.values()), float)
    spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1]
    if spread < np.sqrt(len(places)) * LEAST_CELL_SPREAD:
        raise ValueError("expected cells that are not on one line")
    return cells


Number = Annotated[float, Strict(), Field(ge=-(MOST_FORCE**2), le=MOST_FORCE**2, allow_inf_nan=False)]
Covariance = Annotated[list[list[Number]], AfterValidator(_covariance)]
Zero = Annotated[Any, BeforeValidator(_zero)]
CenterDeviation = Annotated[Any, BeforeValidator(_center_sd)]


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid")


class PoseEntry(_Entry):
    x: Length
    y: Length
    z: Length
    roll: Angle
    pitch: Angle
    yaw: Angle


class BelowEntry(_Entry):
    mass: Load
    mass_sd: Deviation
    center: tuple[Length, Length, Length]
    center_sd: CenterDeviation


class _Mounted(_Entry):
    """A sensor on the ground, whose pose is recorded with every row, or in a foot."""

    name: Literal["right", "left"]
    mount: Literal["ground", "foot"]
    pose: PoseEntry | None = None
    top_height: Length | None = None

    @model_validator(mode="after")
    def _has_a_place(self, info: ValidationInfo) -> Self:
        wanted, other = ("pose", "top_height") if self.mount == "foot" else ("top_height", "pose")
        unknown = self.mount == "foot" and (info.context or {}).get(UNKNOWN_POSE)
        if getattr(self, wanted) is None and not unknown:
            raise ValueError(f"expected key '{wanted}' with mount '{self.mount}'")
        if getattr(self, other) is not None:
            raise ValueError(f"expected no key '{other}' with mount '{self.mount}'")
        return self


class WrenchEntry(_Mounted):
    kind: Literal["wrench"]
    channels: list[str]
    covariance: Covariance | None
    zero: Zero
    below: BelowEntry | None = None

    @model_validator(mode="after")
    def _fits_its_channels(self) -> Self:
        if tuple(self.channels) not in CHANNEL_SETS:
            valid = " or ".join(str(list(channels)) for channels in CHANNEL_SETS)
            raise ValueError(f"expected channels {valid}")
        count = len(self.channels)
        if self.covariance is not None and len(self.covariance) != count:
            raise ValueError(f"expected a covariance of {count} rows, one a channel")
        if isinstance(self.zero, list) and len(self.zero) != count:
            raise ValueError(f"expected a zero of {count} s.d., one a channel")
        if self.below is not None and self.mount == "ground":
            raise ValueError("expected no key 'below' with mount 'ground'")
        return self


class CopEntry(_Mounted):
    kind: Literal["cop"]
    sd: tuple[Deviation, Deviation, Deviation] | None


class CellsEntry(_Entry):
    kind: Literal["cells"]
    name: Literal["right", "left"]
    mount: Literal["ground"] = "ground"
    cells: Annotated[dict[str, Point], Field(min_length=LEAST_CELLS), AfterValidator(_spread_out)]
    top_height: Length

    @property
    def at_corners(self) -> bool:
        """Return whether these are the four cells of a plate of version 1."""
        return set(self.cells) == set(CORNERS)


ContactEntry = Annotated[WrenchEntry | CopEntry | CellsEntry, Discriminator("kind")]


def _pair(entries: list[Any]) -> list[Any]:
    """Return the contacts, right first; refuse a pair that is not of one kind."""
    names = [entry.name for entry in entries]
    if sorted(names) != sorted(PLATES):
        raise ValueError(f"expected one contact named 'right' and one named 'left', found {names}")
    right, left = sorted(entries, key=lambda entry: PLATES.index(entry.name))
    for key in ("kind", "mount", "channels", "covariance"):
        found = [getattr(entry, key, None) for entry in (right, left)]
        if found[0] != found[1]:
            raise ValueError(f"expected the same '{key}' of both, found {found[0]} and {found[1]}")
    if isinstance(right, CopEntry) and (right.sd is None) != (left.sd is None):
        raise ValueError("expected the 'sd' of both, or null for both")
    return [right, left]


Pair = Annotated[list[ContactEntry], Field(min_length=2, max_length=2), AfterValidator(_pair)]


def contacts_of(entries: Sequence[WrenchEntry]) -> Contacts:
    covariance, channels = entries[0].covariance, tuple(entries[0].channels)
    below = [entry.below for entry in entries]
    return Contacts(
        mount=entries[0].mount,
        channels=channels,
        pose=pose_of(entries),
        covariance=None if covariance is None else np.array(covariance, float),
        zero_sd=np.array([_zero_sd(entry.zero, len(channels)) for entry in entries]),
        below=np.array([[0.0] * 4 if one is None else [one.mass, *one.center] for one in below]),
        below_sd=np.array(
            [[0.0] * 4 if one is None else [one.mass_sd, *_three(one.center_sd)] for one in below]
        ),
    )


def pose_of(entries: Sequence[_Mounted]) -> np.ndarray:
    """Return the sensors' poses in their feet, zero on the ground, (2, 6) [m, rad]."""
    poses = [entry.pose for entry in entries]
    return np.array([[0.0 if pose is None else getattr(pose, key) for key in POSE] for pose in poses])


def _zero_sd(zero: Any, count: int) -> list[float]:
    every = {TARED: [0.0] * count, UNKNOWN: [None] * count}.get(zero, zero) if isinstance(zero, str) else zero
    return [np.inf if one is None else float(one) for one in every]


def _three(value: Any) -> list[float]:
    return list(map(float, value)) * (1 if len(value) == 3 else 3) if isinstance(value, list) else [value] * 3


def entries_of(contacts: Contacts, top_height: np.ndarray) -> list[dict[str, Any]]:
    """Return a manifest's entries of wrench sensors or of devices for centres of pressure; heights in m."""
    c, entries = contacts, []
    for side, name in enumerate(PLATES):
        entry: dict[str, Any] = {"name": name, "kind": "wrench", "mount": c.mount}
        if c.cop_sd is None:
            entry["channels"] = list(c.channels)
            entry["covariance"] = None if c.covariance is None else c.covariance.tolist()
            entry["zero"] = _zero_entry(c.zero_sd[side])
        else:
            entry["kind"] = "cop"
            entry["sd"] = None if np.isnan(c.cop_sd).any() else c.cop_sd[side].tolist()
        if c.mount == "ground":
            entry["top_height"] = float(top_height[side])
        else:
            entry["pose"] = dict(zip(POSE, c.pose[side].tolist(), strict=True))
            if c.cop_sd is None:
                entry["below"] = _below_entry(c.below[side].tolist(), c.below_sd[side].tolist())
        entries.append(entry)
    return entries


def _zero_entry(sd: np.ndarray) -> str | list[float | None]:
    if (sd == 0).all():
        return TARED
    return UNKNOWN if np.isinf(sd).all() else [None if np.isinf(one) else one for one in sd.tolist()]


def _below_entry(values: list[float], sd: list[float]) -> dict[str, Any] | None:
    if not any(values) and not any(sd):
        return None
    center_sd = sd[1] if sd[1] == sd[2] == sd[3] else sd[1:]
    return {"mass": values[0], "mass_sd": sd[0], "center": values[1:], "center_sd": center_sd}


def wrong_contacts(contacts: Contacts) -> str:
    """Say what is wrong with the shapes of contacts made in memory; "" if nothing is."""
    if contacts.mount not in ("ground", "foot"):
        return f"mount: found {contacts.mount!r}, expected 'ground' or 'foot'"
    if contacts.channels not in CHANNEL_SETS:
        return f"channels: found {contacts.channels!r}, expected one of {', '.join(map(str, CHANNEL_SETS))}"
    count = len(contacts.channels)
    shapes = {"pose": (2, 6), "zero_sd": (2, count), "below": (2, 4), "below_sd": (2, 4)}
    if contacts.covariance is not None:
        shapes["covariance"] = (count, count)
    if contacts.cop_sd is not None:
        shapes["cop_sd"] = (2, 3)
        if contacts.channels != VERTICAL:
            return f"cop_sd: found with channels {contacts.channels!r}, expected {VERTICAL!r}"
        if np.any(contacts.zero_sd) or np.any(contacts.below):
            return "cop_sd: found with zeros or a foot below, expected none: such a device counts as tared"
    if wrong := wrong_arrays(contacts, shapes):
        return wrong
    if contacts.covariance is not None:
        try:
            _covariance(contacts.covariance.tolist())
        except ValueError as error:
            return f"covariance: found {shortened(contacts.covariance.tolist())}, {error}"
    if not (contacts.zero_sd >= 0).all():
        return "zero_sd: found a number below zero or none, expected 0, an s.d. or infinity"
    if contacts.mount == "ground" and any(
        a.any() for a in (contacts.pose, contacts.below, contacts.below_sd)
    ):
        return "pose, below: found other than zero on the ground, expected zeros"
    return ""

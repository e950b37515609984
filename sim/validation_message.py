"""The wording of pydantic's complaints."""

from __future__ import annotations

from pydantic import ValidationError

from tulip_testbed.sim.errors import shortened


def validation_message(error: ValidationError) -> str:
    """Describe the first complaint of pydantic in one line."""
    first = error.errors()[0]
    place = shortened(".".join(str(part) for part in first["loc"]))
    found = "nothing" if first["type"] == "missing" else shortened(repr(first["input"]))
    return (
        f"key '{place}': found {found}; {shortened(first['msg'].replace('Input should be', 'expected'), 200)}"
    )

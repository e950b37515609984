"""Bounds of the figures in a measurement folder, as types for its manifest."""

from typing import Annotated

from pydantic import AfterValidator, Field, Strict

# Bounds beyond any laboratory: narrow enough that nothing overflows later, wide enough that the preflight
# can still recognise degrees instead of radians and millimetres instead of metres.
MOST_ANGLE = 1e3  # rad
MOST_LENGTH = 1e4  # m, from the base frame to a plate and from a plate to a cell
MOST_FORCE = 1e5  # N, on a cell
MOST_FORCE_ACCELERATION = 1e9  # N/s2 and Nm/s2, of a contact
MOST_SPEED, MOST_ACCELERATION = 1e3, 1e4  # rad/s of a joint; m/s2 of the base, rad/s2 of a joint
MOST_GAIN = 1e6  # Nm/rad, of a servo
LEAST_CELL_SPREAD = 1e-3  # m, r.m.s. of a plate's cells about their best line
LEAST_GRAVITY, MOST_GRAVITY = 0.1, 100.0  # m/s2
LEAST_MASS = 1e-3  # kg
LEAST_DEVIATION = 1e-9  # rad, N, m, kg: noise of smaller ones leaves a covariance that cannot be inverted


def _not_tiny(deviation: float) -> float:
    if 0 < deviation < LEAST_DEVIATION:
        raise ValueError(f"expected 0 or at least {LEAST_DEVIATION:g}")
    return deviation


Length = Annotated[float, Strict(), Field(ge=-MOST_LENGTH, le=MOST_LENGTH, allow_inf_nan=False)]
Angle = Annotated[float, Strict(), Field(ge=-MOST_ANGLE, le=MOST_ANGLE, allow_inf_nan=False)]
Point = tuple[Length, Length]
Gravity = Annotated[float, Strict(), Field(ge=LEAST_GRAVITY, le=MOST_GRAVITY, allow_inf_nan=False)]
Mass = Annotated[float, Strict(), Field(ge=LEAST_MASS, le=MOST_FORCE, allow_inf_nan=False)]
NotNegative = Field(ge=0, le=MOST_FORCE, allow_inf_nan=False)
Deviation = Annotated[float, Strict(), NotNegative, AfterValidator(_not_tiny)]
Gain = Annotated[float, Strict(), Field(gt=0, le=MOST_GAIN, allow_inf_nan=False)]
Version = Annotated[int, Strict(), Field(ge=1, le=1)]

"""Format a number so that a person can read it."""

import math

LARGE = 1e7  # from here on a number has an exponent


def number(value: float, spec: str = ".6g") -> str:
    """Return a number as a person reads it: 820 rather than 8.2e+02, 0.00 rather than -0.00."""
    if not math.isfinite(value):
        return "" if math.isnan(value) else "-"
    text = format(value, spec)
    if "e" in text and 1 <= abs(value) < LARGE:
        text = format(value, "+.0f" if "+" in spec else ".0f")
    elif abs(value) >= LARGE and isinstance(value, float):
        text = format(value, ".3g")
    mantissa, e, exponent = text.partition("e")
    if not float(mantissa):
        mantissa = mantissa.lstrip("+-")
    return f"{mantissa}e{int(exponent)}" if e else mantissa

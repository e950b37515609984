"""A convention of the log that measurements were made from, as an audit found it."""

from dataclasses import dataclass

AXES, WORLD = "axes of the wrench", "world"


@dataclass(frozen=True)
class StatedConvention:
    """A hypothesis about one convention of a log.

    Attributes:
        what: the convention. hypothesis: one of its values.
        log_likelihood: the best with this value, less that of all [-].
        applied: whether the measurements are read so.
    """

    what: str
    hypothesis: str
    log_likelihood: float
    applied: bool

"""Okabe and Ito's palette: colours that colour-blind people can distinguish, one for each thing shown."""

CELL_COLOURS = ("#0072B2", "#56B4E9", "#009E73", "#E69F00")
PALETTE = (*CELL_COLOURS, "#D55E00", "#CC79A7", "#999999", "#F0E442")
MEASURED, ESTIMATE, TRUTH, NOMINAL = "#D55E00", "#0072B2", "#009E73", "#999999"
RESIDUAL, POLYGON, MARGIN, COMMAND = "#CC79A7", "#E69F00", "#56B4E9", "#F0E442"
SKELETON = "#555555"


def rgb(colour: str) -> tuple[int, int, int]:
    """Convert #RRGGBB to numbers from 0 to 255."""
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue

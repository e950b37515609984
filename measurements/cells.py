"""Names of the cells of two four-cell plates."""

CORNERS = ("front_left", "front_right", "rear_right", "rear_left")
PLATES = ("right", "left")
CELLS = tuple(f"{plate}.{corner}" for plate in PLATES for corner in CORNERS)

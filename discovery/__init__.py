"""Where simulation and measurement disagree, what is missing, added, and the gap shown to shrink."""

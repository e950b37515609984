"""Rerun views of plans, measurements and runs; the only importers of rerun."""

ENDING = ".rrd"

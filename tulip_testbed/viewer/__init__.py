"""Rerun views of plans, measurements and runs; no other package imports rerun."""

ENDING = ".rrd"

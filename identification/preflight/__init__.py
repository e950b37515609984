"""The preflight: checks of a measurement folder for faults."""

from tulip_testbed.identification.preflight.all_checks import preflight
from tulip_testbed.identification.preflight.finding import FAIL_LEVEL, RESULTS, WARN_LEVEL, Finding, worst_of

__all__ = ["FAIL_LEVEL", "RESULTS", "WARN_LEVEL", "Finding", "preflight", "worst_of"]

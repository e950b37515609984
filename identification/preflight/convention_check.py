"""Preflight of six-axis sensors in feet: the conventions in which their wrenches are read."""

from __future__ import annotations

from tulip_testbed.identification.conventions.audit_conventions import audit_conventions, can_be_audited
from tulip_testbed.identification.conventions.wrench_convention import WrenchConvention
from tulip_testbed.identification.nominal import Nominal
from tulip_testbed.identification.preflight.finding import Finding, skipped
from tulip_testbed.measurements import Measurements

CONVENTIONS = "conventions"


def conventions(measurements: Measurements, nominal: Nominal) -> Finding:
    """Compare the wrenches with those that the robot needs, in every convention that logs are written in."""
    if not can_be_audited(measurements):
        return skipped(CONVENTIONS, "needs six-axis sensors in the feet and some rows of them")
    found = audit_conventions(measurements, nominal)
    force, moment = 100 * found.residual[:3].max(), 1e3 * found.residual[3:].max()
    taken = [f"{row.what}: {row.hypothesis}" for row in found.rows if row.applied]
    taken += [found.doubt] if found.doubt else []
    changed = found.convention != WrenchConvention()
    return Finding(
        CONVENTIONS,
        "fail" if changed else "warn" if found.problems else "pass",
        f"likeliest are {', '.join(taken)}; not explained are {force:.1f} % of the weight and {moment:.1f} mm"
        if changed or not found.problems
        else "; ".join(found.problems),
        "wrenches of the ground on the robot in the sensor's axes, and joints as in the robot's file",
        advice="Import the log with `import`, which reads it in the likeliest convention, or correct `map`.",
    )

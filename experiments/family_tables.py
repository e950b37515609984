"""A self-calibration as JSON and as tables: families, members, and what limits the base parameters."""

from collections.abc import Sequence

import numpy as np

from tulip_testbed.base.table import Table
from tulip_testbed.calibration.calibration_result import OF_CAD, CalibratedFamily, SelfCalibration
from tulip_testbed.calibration.families import TOLERANCES
from tulip_testbed.effects.catalogue import acts_on, catalogue
from tulip_testbed.measurements.contacts import Contacts

SPREAD = "Spread: estimated s.d. of the members, with its 95 % interval; 1 is usual."
LARGEST_PARTS = 4
MOST_NAMED = 3  # members of a family
LEAST_SHARE = 0.01


def calibration_report(
    found: SelfCalibration, names: tuple[str, ...], contacts: Contacts | None, rows: int
) -> list[Table | str]:
    """Return the tables of families, of members that the data know, and the budget."""
    zero, small, unseen, members = 0, [], [], []
    for one in found.families:
        clear = (one.interval95[:, 0] > 0) | (one.interval95[:, 1] < 0)  # of zero
        zero += int((one.determined & ~clear).sum())
        labels = one.family.labels
        if not one.determined.any():
            (small if one.spread95[1] < 1 else unseen).append(one.family.name)
            continue
        unknown = [label for label, known in zip(labels, one.determined, strict=True) if not known]
        count = f"{len(unknown)} of {len(labels)} members of {one.family.name}"
        unseen += unknown if len(unknown) <= MOST_NAMED else [count]
        for k in np.flatnonzero(one.determined & clear):
            low, high = one.interval95[k].tolist()
            parameters = one.family.effect.parameters_on(labels[k].partition(":")[2])
            value = parameters[k % len(parameters)].text(float(one.value[k]), (low, high))
            members.append([labels[k], value])
    there = {*found.absent, *(one.family.name for one in found.families)}
    usual = [name for name, tolerances in TOLERANCES.items() if any(tolerances) and name not in there]
    exact = [name for name in usual if name in catalogue() and acts_on(catalogue()[name], contacts)]
    said = {
        "Small by what the data say of the family as a whole": small,
        "Known by their tolerance only": unseen,
        "Taken as exact": exact,
        "Left out, since something else is wrong (they would be negative beyond doubt)": found.absent,
    }
    in_time, lasting, count = [], found.noise_in_time, found.effective_rows
    if lasting is not None and count is not None:  # what noise that lasts leaves of the rows of a motion
        share, closure = (f"{100 * one.share:.3g} %" for one in (lasting, lasting.of_closure()))
        lasts = f"{share} of its variance ({closure} in the legs' closure) lasts for {lasting.seconds:.2g} s"
        known = f"{rows} rows determine a constant like {count:.0f} rows with independent noise"
        in_time.append(f"Noise in time: {lasts if lasting.share else 'white'}; {known}.")
    heads = ("imperfection", "value ± half of the 95 % interval")
    determined = f"{zero} members are determined by the data, and zero within their intervals."
    return [
        family_table(found.families, "Ordinary imperfections", singly=True),
        *([Table("Calibrated", heads, members)] if members else []),
        *([determined] if zero else []),
        *(f"{words}: {', '.join(some)}." for words, some in said.items() if some),
        budget_table(found, names, contacts),
        f"{first_to_improve(found).capitalize()}.",
        f"Tolerances: {found.assumed}.",
        *in_time,
    ]


def first_to_improve(found: SelfCalibration) -> str:
    """Say which source gives most of the variance, on average over the base parameters."""
    share = found.shares.mean(axis=1)
    first = int(np.argmax(share))
    part = f"{100 * share[first]:.0f} % of the variance"
    if found.sources[first] == OF_CAD:
        return f"to improve first: what the postures leave to CAD, {part} on average over the parameters"
    return f"to improve first: {found.sources[first]}, {part} on average over the parameters"


def family_table(families: Sequence[CalibratedFamily], title: str, singly: bool = False) -> Table:
    """Return the families with their spreads, and how many members the data determine `singly`."""
    rows = []
    for one in families:
        tolerance = one.family.effect.parameters[0].text(one.family.tolerance)
        count = [f"{int(one.determined.sum())} of {len(one.determined)}"] if singly else []
        rows.append([one.family.name, tolerance, one.spread, *one.spread95, *count])
    spread = ("spread", "tolerances", ".2f"), ("low", "", ".2f"), ("high", "", ".2f")
    heads = ("family", "tolerance", *spread, *["determined singly"] * singly)
    return Table(title, heads, rows, SPREAD)


def budget_table(found: SelfCalibration, names: tuple[str, ...], contacts: Contacts | None) -> Table:
    """Return the largest parts of the variance of every base parameter."""
    rows = []
    for k, name in enumerate(names):
        order = np.argsort(-found.shares[:, k])[:LARGEST_PARTS]
        shares = ((found.sources[j], found.shares[j, k]) for j in order)
        parts = [f"{source} {100 * share:.0f} %" for source, share in shares if share >= LEAST_SHARE]
        rows.append([name, float(np.sqrt(found.covariance[k, k])), ", ".join(parts)])
    heads = ("parameter", ("s.e.", "mm", ".2f", 1e3), "largest parts of its variance")
    sensors, one = ("cells", "cell") if contacts is None else ("contact sensors", "sensor")
    in_feet = contacts is not None and contacts.mount == "foot"
    places = "foot's place: common to a placement" if in_feet else "plate: errors of its recorded place"
    note = (
        f"{sensors}, encoders: their noise; right, left {places}; internal forces: between the feet, "
        f"which no {one} shows; squeeze: the same in all of a placement's postures; spreads: how well "
        "spreads and scales are known; a family: its members."
    )
    return Table("Budget of the standard errors", heads, rows, note)

"""Compare contact, integrator and gate settings by their accuracy (docs/studies/contact-study.md; ten minutes).

The laboratory is free of noise and holds the first ten placements of the shipped plan.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator

import mujoco
import numpy as np

from studies.runner import Settings, header, row, shipped_plan
from tulip_testbed.identification.center_of_pressure import center_of_pressure
from tulip_testbed.measurements import PosturePlan
from tulip_testbed.sim.compliance import Compliance
from tulip_testbed.sim.drives import Drives
from tulip_testbed.sim.dynamics.dynamic_run import run_dynamics
from tulip_testbed.sim.rig import Rig, preset_rig

Edit = Callable[[mujoco.MjSpec], None]
SETTINGS = Settings(seed=1)
PLACEMENTS = 10


def contacts(**attributes: object) -> Edit:
    """Return an edit that sets attributes of the contacts under soles and cells."""

    def edit(spec: mujoco.MjSpec) -> None:
        cells = [geom for geom in spec.geoms if geom.condim == 1]
        for contact in [*spec.pairs, *cells]:
            for name, value in attributes.items():
                setattr(contact, name, value)

    return edit


def friction(seconds: float) -> Edit:
    """Return an edit that sets the time constant of the soles' friction rows."""

    def edit(spec: mujoco.MjSpec) -> None:
        for pair in spec.pairs:
            pair.solreffriction = [seconds, 1]

    return edit


def options(**attributes: object) -> Edit:
    """Return an edit that sets attributes of `<option>`."""

    def edit(spec: mujoco.MjSpec) -> None:
        for name, value in attributes.items():
            setattr(spec.option, name, value)

    return edit


def cases(rig: Rig) -> dict[str, Rig]:
    """Return the laboratories to compare, by the setting in which they differ from the first."""
    implicit = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    edits: dict[str, Edit] = {
        "solref 0.004 s": contacts(solref=[0.004, 1]),
        "solref 0.05 s": contacts(solref=[0.05, 1]),
        "solimp 0.9, 0.95 (MuJoCo's default)": contacts(solimp=[0.9, 0.95, 0.001, 0.5, 2]),
        "solimp 0.99": contacts(solimp=[0.99, 0.99, 0.001, 0.5, 2]),
        "sole friction as stiff as the normal (solreffriction 0.02 s)": friction(0.02),
        "solreffriction 0.005 s": friction(0.005),
        "solver tolerance 1e-8 (MuJoCo's default)": options(tolerance=1e-8),
        "implicitfast": options(integrator=implicit),
        "impratio 10": options(impratio=10.0),
        "time step 2 ms": options(timestep=0.002),
    }
    levels = ((1e-3, 1e-1, 0.1), (1e-4, 1e-2, 0.2), (5e-6, 1e-4, 1.0))
    gates = {
        f"gate {v:g} rad/s for {calm:g} s, then {force:g} N": dataclasses.replace(
            rig.protocol, speed_gate=v, force_gate=force, calm_time=calm
        )
        for v, force, calm in levels
    }
    table = {"as shipped": rig}
    table |= {name: dataclasses.replace(rig, edit=edit) for name, edit in edits.items()}
    table["drives wind up by 1 deg at full torque"] = dataclasses.replace(rig, drives=Drives(wind_up=0.0175))
    table["... and have 0.1 deg of backlash"] = dataclasses.replace(
        rig, drives=Drives(wind_up=0.0175, backlash=0.00175)
    )
    table["soles give way by 0.033 deg/Nm"] = dataclasses.replace(
        rig, compliance=Compliance(sole_tilt=5.76e-4)
    )
    gates["60 s held, last 30 s averaged"] = dataclasses.replace(rig.protocol, gated=False)
    return table | {name: dataclasses.replace(rig, protocol=protocol) for name, protocol in gates.items()}


def measure(rig: Rig, plan: PosturePlan, settings: Settings) -> list[str]:
    """Hold the plan and return the figures of one line."""
    began = time.perf_counter()
    experiment = run_dynamics(rig, plan, settings.seed, settings.workers)
    wall = time.perf_counter() - began
    truth = np.array([held.com for held in experiment.truth.held])
    drift = np.array([held.drift for held in experiment.truth.held])
    lying = np.array([attempt.true_plates for attempt in experiment.truth.measured])
    placed = dataclasses.replace(experiment.measurements, plate_poses=lying)
    error = [(center_of_pressure(m) - truth) for m in (placed, experiment.measurements)]
    balance = np.abs(placed.cell_forces.sum(axis=1) - experiment.truth.mass * placed.gravity).max()
    used = len(plan) - len(experiment.truth.dropped)
    errors = [f"{1e3 * np.sqrt((e**2).mean()):.4f}" for e in error]
    return [
        *(f"{used} / {len(plan)}", *errors, f"{balance:.1e}"),
        *(f"{1e6 * np.median(drift):.0f}", f"{wall:.0f}"),
    ]


def study(settings: Settings) -> Iterator[str]:
    """Yield a table with a line for each setting."""
    rig = preset_rig("ideal")
    plan = shipped_plan(rig.robot, settings.count(PLACEMENTS))
    lying, recorded = "CoP - CoM, plates as they lie (mm r.m.s.)", "as recorded (mm r.m.s.)"
    figures = ("worst force balance (N)", "median foot drift (um)", "wall (s)")
    yield header("setting", "usable", lying, recorded, *figures)
    for name, case in cases(rig).items():
        yield row(name, *measure(case, plan, settings))

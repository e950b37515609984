"""`tulip simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from tulip_testbed.cli.options import (
    CORES,
    DEFAULT_SEED,
    Imperfections,
    Json,
    Plan,
    RigFolder,
    RobotFile,
    Seed,
    Sensors,
    Workers,
)
from tulip_testbed.sim.shipped import TULIP

Effects = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    tyro.conf.arg(
        name="effect",
        metavar="NAME[:TARGET]=VALUE[,VALUE]",
        help="add a physical effect (SI units; see `tulip effects`), or `random` for one that is not told",
    ),
]
Statics = Annotated[
    bool,
    tyro.conf.arg(help="solve the static equilibrium of every posture instead of its dynamics"),
]


ExperimentFolder = Annotated[
    Path | None,
    tyro.conf.arg(help="plan folder that `tulip next` wrote: its postures after its manipulations"),
]


def simulate_command(
    plan: Plan = None,
    /,
    *,
    out: Annotated[Path, tyro.conf.arg(help="new measurement folder")],
    preset: Sensors = "wii",
    seed: Seed = DEFAULT_SEED,
    truth: Annotated[Path | None, tyro.conf.arg(help="new file for the truth")] = None,
    effect: Effects = (),
    imperfections: Imperfections = 0.0,
    rig: RigFolder = None,
    experiment: ExperimentFolder = None,
    session: Annotated[
        str | None, tyro.conf.arg(help="name of the session; its experiments share tares, floor and survey")
    ] = None,
    statics: Statics = False,
    workers: Workers = CORES,
    robot: RobotFile = TULIP,
    as_json: Json = False,
) -> int:
    """Simulate an experiment and write a measurement folder.

    The folder does not contain the truth; --truth FILE writes it to another file. Only that file names the
    effect that `--effect random` draws, and the imperfections.

    Example: tulip simulate --out data/first --effect encoder-offset:right_knee=0.01 --truth first-truth.json

    Example: tulip simulate --out data/real --imperfections 1 --truth real-truth.json

    Example: tulip simulate --experiment plans/next --out data/second --effect encoder-offset:right_knee=0.01
    """
    import numpy as np

    from tulip_testbed.base.errors import InputError
    from tulip_testbed.base.files import present
    from tulip_testbed.cli.laboratory_options import laboratory_and_plan
    from tulip_testbed.cli.terminal import print_json, progress, say, show
    from tulip_testbed.effects.random_effects import RANDOM
    from tulip_testbed.experiments.imperfections import check_imperfections, drawn, single_stream
    from tulip_testbed.experiments.laboratory import tries
    from tulip_testbed.experiments.proposed_experiment import EXPERIMENT_FILE, read_experiment
    from tulip_testbed.experiments.run_summary import usable_postures
    from tulip_testbed.experiments.truth_record import check_places, write_experiment

    check_places(out, truth)
    secret = RANDOM in effect
    if secret and truth is None:
        raise InputError("--effect random: found no --truth FILE, expected one: nothing else would know it")
    wanted, number = (None, 1) if experiment is None else read_experiment(experiment)
    if experiment is not None and plan is not None:
        raise InputError("experiment: found a plan besides, expected the plan of its own folder")
    if plan is not None and present(plan / EXPERIMENT_FILE):
        raise InputError(
            f"{plan}: found {EXPERIMENT_FILE}, expected --experiment {plan}: a plain plan would leave its "
            "manipulations out"
        )
    laboratory, made = laboratory_and_plan(robot, preset, plan or experiment, rig, effect, seed, statics)
    check_imperfections(laboratory, imperfections)
    laboratory = drawn(laboratory, imperfections, single_stream(seed))
    if wanted is not None or session is not None:
        texts = () if wanted is None else wanted.manipulations
        there = "" if wanted is None else wanted.session
        laboratory = laboratory.manipulated(*texts, session=there if session is None else session)
    # The laboratory is that of the seed; its noise differs from experiment to experiment.
    noise = seed if number == 1 else int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
    engine = "statics" if statics else "dynamics"
    try:
        with progress("holding postures", tries(laboratory, made)) as advance:
            run = laboratory.run(made, noise, engine, workers, advance)
    except InputError:
        if not secret:
            raise
        raise InputError(
            f"--effect random: found an experiment that cannot be carried out with the effect that "
            f"--seed {seed} draws, expected one that can; give another --seed"
        ) from None
    write_experiment(out, truth, run)
    if as_json:
        dropped = run.truth.dropped
        print_json(
            {
                "measurements": str(out),
                "postures_planned": made.postures,
                "rows": len(run.measurements),
                "dropped": [{"posture": p, "reason": None if secret else r} for p, r in dropped],
            }
        )
    else:
        show(*usable_postures(run, {}, reasons=not secret))
    say(f"Measurement folder: {out}")
    return 0

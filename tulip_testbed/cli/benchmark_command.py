"""`tulip benchmark discover`."""

from __future__ import annotations

from typing import Annotated, Literal

import tyro

from tulip_testbed.cli.options import CORES, Address, EngineName, Json, NoisySensors, RunFolder, Seed, Workers

Size = Annotated[
    float,
    tyro.conf.arg(metavar="SCALE", help="scale of the number of cases; 1 is the full benchmark, hours"),
]
World = Annotated[
    Literal["exact", "ordinary"],
    tyro.conf.arg(
        help="exact: the nominal robot, instruments exact but for what is hidden; ordinary: random robots "
        "and ordinary imperfections of all families"
    ),
]
What = Annotated[Literal["discover"], tyro.conf.Positional]


def benchmark_command(
    what: What,
    /,
    *,
    out: RunFolder,
    preset: NoisySensors = "force-plate",
    seed: Seed = 0,
    size: Size = 0.2,
    world: World = "exact",
    engine: EngineName = "loky",
    address: Address = None,
    workers: Workers = CORES,
    as_json: Json = False,
) -> int:
    """Count how often `tulip discover` finds simulated effects.

    Seeds 0 to 99 are for development; others are for tests that nothing was fitted to.
    The same command resumes a run that was stopped, and reports again on a finished one. After Ctrl-C it
    reports on the cases so far, which is fair because they are in random order. However small the scale, the
    exact world has some 120 cases.
    Exit code 0: done; 2: could not run; 130: interrupted.

    Example: tulip benchmark discover --out runs/benchmark --preset force-plate --seed 1000 --size 0.2

    Example: tulip benchmark discover --out runs/ordinary --world ordinary --seed 1000 --size 0.1
    """
    import time

    from tulip_testbed.base.files import write_bytes
    from tulip_testbed.cli.terminal import print_json, progress, say, show
    from tulip_testbed.experiments.benchmark.benchmark_run import benchmark, so_far
    from tulip_testbed.experiments.benchmark.benchmark_tables import files, report_document, tables
    from tulip_testbed.experiments.benchmark.cases import Settings
    from tulip_testbed.experiments.montecarlo.engine import check_engine
    from tulip_testbed.experiments.montecarlo.montecarlo_run import Interrupted

    check_engine(engine, address)
    began = time.perf_counter()
    code = 0
    try:
        settings = Settings(preset, seed, size, world)
        outcomes = benchmark(settings, out, workers, progress=progress, address=address)
    except Interrupted as error:
        say(f"tulip: {error}")
        outcomes, code = so_far(out), 130
    stopped = ", stopped" if code else ""
    heading = f"{len(outcomes)} cases, {world} world, preset {preset}, seed {seed}, size {size:g}{stopped}"
    for name, text in files(outcomes, heading, world).items():
        write_bytes(out / name, text.encode())
    if as_json:
        print_json(report_document(outcomes, world) | {"wall_s": time.perf_counter() - began})
    else:
        show(*tables(outcomes, world))
    say(f"Run folder: {out}")
    return code

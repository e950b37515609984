"""The searches of `tulip plan` with their progress."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from tulip_testbed.cli.terminal import best_so_far, print_json, say, show
from tulip_testbed.experiments.plan_description import described_plan, trial_table
from tulip_testbed.experiments.plan_state import read_state
from tulip_testbed.experiments.planning_jobs import Job
from tulip_testbed.experiments.planning_run import Search, carry_out
from tulip_testbed.experiments.written_plan import (
    CHOSEN,
    TABLE1,
    TABLE1_SEEDS,
    joined_trials,
    written_plan,
)
from tulip_testbed.measurements import PosturePlan


def searched(job: Job, kept: Path, label: str) -> tuple[PosturePlan, bool]:
    """Carry out a search with a progress bar; return its plan and whether it came to its end."""
    state = read_state(kept, job.key)
    with best_so_far(label, job.rounds, state.rounds if state else 0) as advance:
        return carry_out(job, kept, lambda found: advance(found.rounds, found.value))


def table1_trials(search: Search, out: Path, preset: str, as_json: bool) -> int:
    """Search from six random starts, join the best three plans and return the exit code."""
    robot, rows, plans = search.robot, [], []
    for seed, paper in zip(TABLE1_SEEDS, TABLE1, strict=True):
        began = time.process_time()
        kept = out.with_name(f".{out.name}.seed{seed}.state.json")
        plan, finished = searched(search.job(seed), kept, f"seed {seed}")
        if not finished:
            say("tulip: interrupted; give the same command to go on")
            return 130
        plans.append(plan)
        said = described_plan(robot, plan, preset)
        rows.append(
            {
                "seed": seed,
                "initial_condition_number": plan.made["initial_condition_number"],
                "condition_number": said["condition_number"],
                "paper_initial": paper[0],
                "paper": paper[1],
                "cpu_s": time.process_time() - began,
            }
        )
    order = np.argsort([row["condition_number"] for row in rows], kind="stable")[:CHOSEN]
    best = search.extended(joined_trials([plans[k] for k in order]))
    said = written_plan(robot, best, out, preset)
    for seed in TABLE1_SEEDS:
        out.with_name(f".{out.name}.seed{seed}.state.json").unlink(missing_ok=True)
    document = {"trials": rows, "chosen": [TABLE1_SEEDS[k] for k in order], **said}
    if as_json:
        print_json(document)
        return 0
    show(trial_table(rows))
    return 0

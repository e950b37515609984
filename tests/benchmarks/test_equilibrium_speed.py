"""A posture's static equilibrium against its hold in full dynamics, in one run."""

import dataclasses
import time

import numpy as np

from tulip_testbed.sim.dynamics.hold import hold, put_down
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.statics.solved_plan import solve_plan
from tulip_testbed.sim.statics.static_run import run_statics

RUNS = 50


def test_a_posture_in_statics_and_held_for_a_minute(benchmark, robot, plan):
    rig = preset_rig("wii", robot)
    solved_plan = solve_plan(rig, plan)
    streams = np.random.SeedSequence(1).spawn(RUNS)
    runs = benchmark.pedantic(run_statics, (solved_plan, streams), rounds=3, warmup_rounds=1)
    postures = sum(len(run.measurements) + len(run.truth.dropped) for run in runs)
    static = benchmark.stats.stats.min / postures
    whole = dataclasses.replace(rig, protocol=dataclasses.replace(rig.protocol, gated=False))
    stand = Stand(whole, boards_under(whole, plan.foot_poses[:1])[0])
    put_down(stand, plan.joint_angles[0])
    began = time.perf_counter()
    held, reason = hold(stand, plan.joint_angles[0])
    dynamic = time.perf_counter() - began
    assert held is not None, reason
    benchmark.extra_info["static_us"] = round(1e6 * static, 1)
    benchmark.extra_info["dynamic_over_static"] = round(dynamic / static)
    print(f"\nstatics {1e6 * static:.0f} us a posture, hold {dynamic:.2f} s: {dynamic / static:.0f} times")

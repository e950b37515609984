"""Base parameters of a 31-link humanoid: our structural derivation against FIGAROH's numerical one."""

import time
import warnings

import numpy as np
import pytest

from tulip_testbed.identification.base_parameters import base_parameters
from tulip_testbed.sim.robot import joint_names

MOST_SECONDS, MOST_RATIO = 1.0, 0.2
# FIGAROH's own examples draw 100 or 1000 random postures for a base parameter set.
POSTURES = (100, 300, 1000)

with warnings.catch_warnings():  # Pinocchio's bindings warn about converters registered twice
    warnings.simplefilter("ignore", RuntimeWarning)
    reason = "extra 'oracle' is not installed (make oracle)"
    pin = pytest.importorskip("pinocchio", reason=reason)
    qrdecomposition = pytest.importorskip("figaroh.tools.qrdecomposition", reason=reason)
    regressor = pytest.importorskip("figaroh.tools.regressor", reason=reason)


def figaroh_base_parameters(robot, count, low, high):
    """Static regressor of random postures in the stance foot's frame, then FIGAROH's decomposition."""
    rng, data = np.random.default_rng(0), robot.createData()
    foot = robot.getFrameId("rfoot", pin.FrameType.BODY)
    mass = sum(inertia.mass for inertia in robot.inertias)
    rows = []
    for _ in range(count):
        q = pin.neutral(robot)
        q[7:] = rng.uniform(low, high)
        pin.framesForwardKinematics(robot, data, q)
        matrix = pin.computeStaticRegressor(robot, data, q).copy()
        matrix[:, 0::4] -= data.oMf[foot].translation[:, None] / mass
        rows.append((data.oMf[foot].rotation.T @ matrix)[:2])
    stacked = np.vstack(rows)
    names = [f"{joint}.{k}" for joint in robot.names[1:] for k in ("m", "mx", "my", "mz")]
    unseen, observed = regressor.get_index_eliminate(stacked, dict.fromkeys(names, 0.0), 1e-6)
    return qrdecomposition.QRDecomposer().decompose(
        regressor.build_regressor_reduced(stacked, unseen), observed
    )


def least_time(function, rounds):
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return min(times)


def test_base_parameters_against_figaroh(benchmark, foreign):
    robot = foreign["humanoid_CMU"]
    model, theirs = robot.model, pin.buildModelFromMJCF(str(robot.model_file))
    low, high = np.array([model.joint(name).range for name in joint_names(model)]).T
    count = figaroh_base_parameters(theirs, 100, low, high).rank
    assert len(base_parameters(robot, model, "right").names) == count
    benchmark.pedantic(base_parameters, (robot, model, "right"), rounds=30, warmup_rounds=2)
    ours = benchmark.stats["min"]
    print(f"\n{count} base parameters of {model.nbody - 1} links: {1e3 * ours:.1f} ms; FIGAROH's:")
    for postures in POSTURES:
        figaroh = least_time(lambda n=postures: figaroh_base_parameters(theirs, n, low, high), 5)
        print(f"  from {postures} postures {1e3 * figaroh:.1f} ms, ratio {ours / figaroh:.3f}")
    assert ours <= MOST_SECONDS
    assert ours <= MOST_RATIO * figaroh

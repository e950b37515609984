"""Workers of a command that was killed or asked to end are gone soon after."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from threading import Event, Thread

import pytest
from threadpoolctl import threadpool_info

from tests.test_cli import in_a_process
from tulip_testbed.base.threads import one_blas_thread
from tulip_testbed.sim.plan_folder import write_plan

MOST = 20  # s, until the last worker is gone


def workers_of(parent: int) -> set[int]:
    """Numbers of the processes below one that have loaded the simulator, from /proc."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            above = int(path.read_text().rsplit(")", 1)[1].split()[1])
            command = (path.parent / "cmdline").read_text()
        except OSError:
            continue
        if above == parent and "popen_loky" in command:
            found.add(int(path.parent.name))
    return found


def alive(number: int) -> bool:
    try:
        return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_workers_do_not_hear_what_a_terminal_sends_to_all():
    code = """
import signal, joblib
from tulip_testbed.base.workers import deaf_to_interruptions, watched
blocked = joblib.delayed(signal.pthread_sigmask)(signal.SIG_BLOCK, ())
with deaf_to_interruptions():
    workers = joblib.Parallel(2, return_as="generator", **watched())(blocked for _ in range(2))
here = signal.pthread_sigmask(signal.SIG_BLOCK, ())
print([signal.SIGINT in mask for mask in (*workers, here)])
"""
    done = in_a_process(code)
    assert done.stdout == "[True, True, False]\n", done.stderr


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc")
@pytest.mark.parametrize("how", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "command",
    [("montecarlo", "--runs", "100000"), pytest.param(("simulate",), marks=pytest.mark.slow)],
    ids=["montecarlo", "simulate"],
)
def test_no_worker_outlives_its_command(how, command, plan, tmp_path):
    write_plan(tmp_path / "plan", plan)
    name, *more = command
    arguments = [name, str(tmp_path / "plan"), "--out", str(tmp_path / "out"), "--workers", "2", *more]
    code = f"import sys; from tulip_testbed.cli.main import main; sys.exit(main({arguments}))"
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        end = time.monotonic() + 60
        while len(found := workers_of(process.pid)) < 2:
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.1)
        process.send_signal(how)
        process.wait(timeout=10)
        end = time.monotonic() + MOST
        while any(map(alive, found)):
            assert time.monotonic() < end
            time.sleep(0.1)
    finally:
        process.kill()
        for number in filter(alive, found):
            os.kill(number, signal.SIGKILL)


def test_linear_algebra_has_one_thread_until_the_last_call_has_ended():
    def threads():
        return [one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"]

    inside, leave = [Event(), Event()], [Event(), Event()]

    @one_blas_thread
    def work(k):
        inside[k].set()
        leave[k].wait(10)

    before, calls = threads(), [Thread(target=work, args=(k,)) for k in (0, 1)]
    for call, event in zip(calls, inside, strict=True):
        call.start()
        event.wait(10)
    leave[0].set()
    calls[0].join()
    assert set(threads()) == {1}
    leave[1].set()
    calls[1].join()
    assert threads() == before

"""The live view of `tulip watch`: what is logged of each posture, and the real server."""

from __future__ import annotations

import urllib.request

import numpy as np
import pytest
import rerun as rr

from tests.watched import measured_day, model_of, play
from tulip_testbed.viewer import watch_view
from tulip_testbed.viewer.window import END


@pytest.fixture(scope="module")
def verdicts(robot, plan):
    rows = measured_day(robot, plan).take(np.arange(3))
    return play(model_of(robot, plan, rows), rows)[1]


def test_every_posture_is_logged(verdicts, plan, nominal, tmp_path):
    path, recording = tmp_path / "day.rrd", rr.RecordingStream("tulip")
    recording.save(path)
    watch_view.begin(recording, plan, nominal)
    sizes = []
    for row, verdict in enumerate(verdicts, 1):
        watch_view.log_verdict(recording, plan, nominal, verdict, row)
        recording.flush()
        sizes.append(path.stat().st_size)
    recording.disconnect()
    content = path.read_bytes()
    assert END in content[-2 * len(END) :]
    assert sizes == sorted(set(sizes))
    for entity in (b"/misfit/A", b"/misfit/C", b"/verdicts", b"/world/robot/torso"):
        assert entity in content


@pytest.mark.slow
def test_the_day_is_served_to_this_machine(verdicts, plan, robot):
    told = []
    with watch_view.served_watch(plan, robot, told.append) as log:
        for verdict in verdicts:
            log(verdict)
        (address,) = told
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address.partition("?")[0], timeout=20) as page:
            assert b"rerun" in page.read().lower()

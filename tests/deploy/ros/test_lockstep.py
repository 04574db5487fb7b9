"""`simulate --lockstep` on real graphs: the same drive as in an environment, however long an answer takes."""

from __future__ import annotations

import signal

import numpy as np
import pytest

import tb2rl

pytestmark = pytest.mark.slow
SCAN, SCANS = "/kobuki/laser/scan", "sensor_msgs/LaserScan"


def test_in_lockstep_a_drive_is_the_environments_to_the_bit_and_a_signal_ends_it(graph):
    options = ["--rate", "0", "--scan-rate", "5", "--lockstep", "60", "--simulation", "kinematic", "--seed", "3"]
    commands = [(0.5, 0.0), (0.05, 1.0), (0.5, 0.0), (0.05, -1.0), (0.5, 0.0)] * 8
    env = tb2rl.make_env("maze", "raw", simulation="kinematic", beams=720)
    env.reset(seed=3)
    expected = [env.unwrapped.robot_state.ranges[0]]
    for _, w in commands:
        env.step(0 if w == 0.0 else 1 if w > 0.0 else 2)
        expected.append(env.unwrapped.robot_state.ranges[0])
    with graph.start("simulate", *options, "--set", "task.start=random") as simulated, graph.probe() as probe:
        probe.subscribe(SCAN, SCANS)
        scans = probe.ask("answer", topic="/cmd_vel", scans=SCAN, commands=commands)
        status = simulated.stop({1: signal.SIGINT, 2: signal.SIGTERM}[graph.version])
        assert (status, simulated.errors) == (0, [])
        first, record, unanswered = simulated.lines
    for scan, ranges in zip(scans, expected, strict=True):
        np.testing.assert_array_equal(np.float32(scan["ranges"]), np.float32(ranges))
    assert first == f"simulating maze in loop (kinematic) on ROS {graph.version}"
    assert "): 8.0 s, " in record
    assert unanswered == "scans that no command answered: 0"

"""`--simulation ros` on real graphs of ROS 1 and ROS 2: the robot of `simulate` is evaluated and filmed."""

from __future__ import annotations

import json
import signal

import av
import pytest

import tb2rl

pytestmark = pytest.mark.slow
POLICY = "zoo:maze-loop-ppo"
LOCKSTEP = ["--rate", "0", "--scan-rate", "5", "--lockstep", "60"]


def simulate(graph, *more):
    return graph.start("simulate", "--topics", "scan=/scan", *more)


def on_robot(graph, command, *arguments):
    """A command that drives the robot of the graph."""
    sim_time = ["--ros-args", "-p", "use_sim_time:=true"] if graph.version == 2 else []
    arguments = [POLICY, "--simulation", "ros", "--ros", str(graph.version), *arguments, *sim_time]
    return graph.command(command, *arguments)


def speed_on_robot(graph, *arguments):
    with on_robot(graph, "evaluate", *arguments, "--json", "result.json") as evaluating:
        assert evaluating.wait() == 0, evaluating.errors
    result = json.loads((graph.folder / "result.json").read_text())
    assert result["simulation"] == "ros"
    assert {each["ended"] for each in result["each"]} == {"time limit"}
    return result["mean_speed"]


def test_an_evaluation_there_is_as_one_here(graph):
    with simulate(graph, *LOCKSTEP) as simulated:
        found = speed_on_robot(graph, "--steps", "300")
        assert simulated.stop() == 0
    expected = tb2rl.evaluate(POLICY, episodes=4, steps=300, workers=1).summary()["mean_speed"]
    print("speed", found, "evaluated", expected)
    assert found == pytest.approx(expected, rel=0.05)


def test_it_drives_in_real_time(graph):
    with simulate(graph):
        assert speed_on_robot(graph, "--steps", "40") > 0.3, "on a machine that may be busy"


def test_a_film_of_it(graph):
    with simulate(graph, *LOCKSTEP), on_robot(graph, "play", "--steps", "20", "--video", "drive.mp4") as playing:
        assert playing.wait() == 0, playing.errors
    with av.open(str(graph.folder / "drive.mp4")) as file:
        assert sum(1 for _ in file.decode(video=0)) == pytest.approx((20 * 0.2 + 1) * 15, abs=2)


def test_who_ends_the_command_stops_the_robot(graph):
    velocity = {1: "/cmd_vel_mux/input/navi", 2: "/cmd_vel"}[graph.version]
    with simulate(graph), graph.probe() as probe:
        probe.listen("/clock", "rosgraph_msgs/Clock")
        probe.ask("watch", velocity=velocity, odometry="/odom")
        for sign in (signal.SIGINT, signal.SIGTERM):
            with on_robot(graph, "evaluate") as evaluating:
                probe.ask("watched", until="moved", seconds=1.0)
                assert evaluating.stop(sign) == 130
                assert [line for line in evaluating.errors if "Traceback" in line] == []
            ended = probe.ask("watched", seconds=1.0)
            assert ended["told to stand"] > ended["told to move"]


def test_who_loses_the_robot_says_so(graph):
    with simulate(graph) as simulated, on_robot(graph, "evaluate") as evaluating, graph.probe() as probe:
        probe.listen("/clock", "rosgraph_msgs/Clock")
        probe.ask("watch", velocity={1: "/cmd_vel_mux/input/navi", 2: "/cmd_vel"}[graph.version], odometry="/odom")
        probe.ask("watched", until="moved", seconds=1.0)
        simulated.close()
        assert evaluating.wait() == 2
    assert evaluating.errors[-1] == "error: the robot stands: no scan on /scan"

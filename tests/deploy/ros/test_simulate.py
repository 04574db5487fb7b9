"""`simulate` on a graph of plain Python: it keeps time, waits for answers, and does as Gazebo's services say."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from itertools import pairwise

import pytest

from tb2rl.deploy.ros.messages import Velocity
from tb2rl.deploy.ros.simulate import Server
from tb2rl.deploy.ros.simulator import Simulator
from tb2rl.deploy.ros.topics import Topics
from tb2rl.envs.scene import make_scene
from tb2rl.tasks.wander import Wander

PATIENCE = 30.0  # [s]
SCAN, ODOMETRY, VELOCITY = "/kobuki/laser/scan", "/odom", "/cmd_vel"


@contextmanager
def running(graph, rate=0.0, lockstep=None, before=lambda: None):
    simulator = Simulator(make_scene(Wander(start="fixed"), "raw"), "kinematic", 0, 10.0, lockstep is not None)
    server = Server(simulator, graph, Topics(), rate, lockstep)
    before()
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield simulator
    finally:
        graph.over = True
        thread.join(PATIENCE)
    server.close()


def wait_until(condition):
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.002)


def test_time_runs_as_fast_as_it_can_until_it_is_paused(fake_graph):
    with running(fake_graph) as simulator:
        said = fake_graph.ends["/clock"].said
        wait_until(lambda: len(said) > 100)
        fake_graph.services["/gazebo/pause_physics"]()
        paused = simulator.clock().stamp
        time.sleep(0.3)
        assert simulator.clock().stamp == paused
        fake_graph.services["/gazebo/unpause_physics"]()
        wait_until(lambda: simulator.clock().stamp > paused)
    assert fake_graph.keeps_time
    assert [after.stamp - before.stamp for before, after in pairwise(said)][:50] == [25_000_000] * 50
    assert len(fake_graph.ends[SCAN].said) == pytest.approx(len(said) / 4, abs=1)
    assert len(fake_graph.ends[ODOMETRY].said) == len(fake_graph.ends["/tf"].said) == len(said)


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_time_runs_at_the_rate_that_was_asked_for(rate, fake_graph):
    with running(fake_graph, rate) as simulator:
        wait_until(lambda: simulator.clock().stamp > 0)
        began, stamp = time.monotonic(), simulator.clock().stamp
        wait_until(lambda: simulator.clock().stamp > stamp + rate * 0.5e9)
        took = time.monotonic() - began
    assert 0.4 < took < 1.5, "0.5 s on a machine with nothing else to do"


def test_a_long_pause_is_not_made_up_for(fake_graph):
    with running(fake_graph, rate=1.0) as simulator:
        fake_graph.services["/gazebo/pause_physics"]()
        before = simulator.clock().stamp
        time.sleep(0.6)
        fake_graph.services["/gazebo/unpause_physics"]()
        time.sleep(0.1)
        fake_graph.services["/gazebo/pause_physics"]()
        assert simulator.clock().stamp - before <= 0.3e9


def test_in_lockstep_no_time_passes_until_a_command_answers_a_scan(fake_graph, capsys):
    with running(fake_graph, lockstep=PATIENCE):
        scans = fake_graph.ends[SCAN].said
        for number in range(1, 6):
            wait_until(lambda number=number: len(scans) == number)
            time.sleep(0.02)
            assert len(scans) == number
            fake_graph.heard[VELOCITY](Velocity(0.5, 0.0))
        wait_until(lambda: len(scans) == 6)
    assert [scan.stamp for scan in scans] == [number * 100_000_000 for number in range(6)]
    assert capsys.readouterr().out.splitlines()[-1] == "scans that no command answered: 0"


def test_in_lockstep_a_command_right_after_a_pause_answers_the_scan_before_it(fake_graph):
    def resume():
        fake_graph.services["/gazebo/pause_physics"]()
        fake_graph.services["/gazebo/unpause_physics"]()
        fake_graph.heard[VELOCITY](Velocity(0.5, 0.0))

    with running(fake_graph, lockstep=PATIENCE, before=resume) as simulator:
        wait_until(lambda: len(fake_graph.ends[SCAN].said) == 2)
        time.sleep(0.02)
        assert simulator.clock().stamp == 100_000_000, "one command, one scan"


def test_in_lockstep_time_waits_for_somebody_to_be_there_and_for_an_answer_not_for_ever(fake_graph, capsys):
    fake_graph.publisher(SCAN, None).there = False
    with running(fake_graph, lockstep=0.05) as simulator:
        time.sleep(0.3)
        assert simulator.clock().stamp == 0
        fake_graph.ends[SCAN].there = True
        wait_until(lambda: simulator.clock().stamp >= 300_000_000)
    assert int(capsys.readouterr().out.split()[-1]) >= 3


def test_in_lockstep_programs_that_wait_before_they_drive_hear_the_present_instant(fake_graph, monkeypatch):
    monkeypatch.setattr("tb2rl.deploy.ros.simulate._LOOK_UP", 0.01)
    monkeypatch.setattr("tb2rl.deploy.ros.simulate._ALONE", 0.1)
    for topic in (VELOCITY, "/cmd_vel_mux/input/navi", SCAN):
        fake_graph.publisher(topic, None).there = False
    with running(fake_graph, lockstep=PATIENCE) as simulator:
        ends = fake_graph.ends
        for topic in (ODOMETRY, "/clock", "/tf"):
            wait_until(lambda topic=topic: len(ends[topic].said) > 2)
        assert ends[SCAN].said == [], "nobody hears it"
        ends[SCAN].there = True
        wait_until(lambda: len(ends[SCAN].said) > 1)
        assert {message.stamp for topic in (ODOMETRY, "/clock", "/tf", SCAN) for message in ends[topic].said} == {0}
        ends[VELOCITY].there = True
        wait_until(lambda: simulator.clock().stamp > 0 or fake_graph.heard[VELOCITY](Velocity(0.5, 0.0)))


def test_who_leaves_the_lockstep_stops_it_without_a_scan_unanswered(fake_graph, capsys):
    with running(fake_graph, lockstep=PATIENCE) as simulator:
        wait_until(lambda: fake_graph.ends[SCAN].said)
        fake_graph.ends[SCAN].there = False
        time.sleep(0.5)
        assert simulator.clock().stamp == 0
    assert capsys.readouterr().out.splitlines()[-1] == "scans that no command answered: 0"


def test_a_reset_puts_the_robot_back_says_how_it_went_and_in_lockstep_scans_again(fake_graph, capsys):
    with running(fake_graph, lockstep=PATIENCE) as simulator:
        scans = fake_graph.ends[SCAN].said
        start = simulator.odometry().pose
        for number in range(1, 6):
            wait_until(lambda number=number: len(scans) == number)
            fake_graph.heard["/cmd_vel_mux/input/navi"](Velocity(0.5, 0.0))
        wait_until(lambda: len(scans) == 6)
        assert simulator.odometry().pose[0] > start[0] + 0.1
        fake_graph.services["/gazebo/reset_world"]()
        assert simulator.odometry().pose == start
        wait_until(lambda: len(scans) == 7)
        assert (scans[6].stamp, scans[6].ranges.tolist()) == (scans[5].stamp, scans[0].ranges.tolist())
        fake_graph.services["/gazebo/reset_simulation"]()
        wait_until(lambda: len(scans) == 8)
        assert scans[7].stamp == 0
    told = capsys.readouterr().out.splitlines()
    assert told[0].startswith("from (-3.75, -3.75, 0.00): 0.5 s, 0.2 m, touched something 0 times, nearest range ")
    assert len(told) == 2, "nothing to say of an episode without a step"


def test_images_are_made_only_where_somebody_looks(fake_graph, monkeypatch):
    looked = []
    images = Simulator.images
    monkeypatch.setattr(Simulator, "images", lambda self: looked.append(1) or images(self))
    fake_graph.publisher("/camera/depth/image_raw", None).there = False
    with running(fake_graph):
        wait_until(lambda: len(fake_graph.ends[SCAN].said) > 3)
        assert looked == []
        fake_graph.ends["/camera/depth/image_raw"].there = True
        wait_until(lambda: fake_graph.ends["/camera/depth/image_raw"].said)
    assert "/camera/rgb/image_raw" not in fake_graph.ends, "the twin has no colours"

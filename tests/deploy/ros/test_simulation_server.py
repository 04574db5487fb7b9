"""`simulate` on a fake node: rate, lockstep, and the services of Gazebo."""

from itertools import pairwise

import pytest

from tb2rl.deploy.ros.messages import Twist
from tb2rl.deploy.ros.simulated_robot import SimulatedRobot
from tb2rl.deploy.ros.simulation_server import SimulationServer
from tb2rl.deploy.ros.topics import Topics
from tb2rl.envs.scene import make_scene
from tb2rl.simulation import find_simulator
from tb2rl.tasks.wander import Wander

SCAN, ODOMETRY, VELOCITY, NAVIGATION = "/kobuki/laser/scan", "/odom", "/cmd_vel", "/cmd_vel_mux/input/navi"
FORWARD = Twist(0.5, 0.0)
TIMEOUT = 30.0  # [s]


@pytest.fixture
def simulate(node, clock, monkeypatch):
    """A function that runs a server until `seconds` of wall-clock time have passed, or a program ends it."""
    monkeypatch.setattr("tb2rl.deploy.ros.simulation_server.WallClock", lambda: clock)

    def run(rate=0.0, lockstep=None, seconds=20.0, before=lambda: None):
        scene, kinematic = make_scene(Wander(start="fixed"), "raw"), find_simulator("kinematic")
        robot = SimulatedRobot(scene, kinematic, 0, 10.0, lockstep is not None)
        server = SimulationServer(robot, node, Topics(), rate, lockstep)
        clock.events.append(lambda: setattr(node, "over", node.over or clock.time >= seconds))
        before()
        server.run()
        server.close()

    return run


def answer_scans(node, scans=6):
    """Answer each scan; end the node after so many."""

    def react(scan):
        if len(node.topics[SCAN].messages) == scans:
            node.over = True
        else:
            node.receive[VELOCITY](FORWARD)

    node.topics[SCAN].react = react


def stamps(node, topic):
    return [message.stamp for message in node.topics[topic].messages]


def unanswered_scans(capsys):
    return int(capsys.readouterr().out.splitlines()[-1].removeprefix("scans that no command answered: "))


def test_full_speed_publishes_odometry_and_transforms_each_tick_and_scans_at_their_rate(simulate, node):
    simulate(seconds=0.01)
    ticks = stamps(node, "/clock")
    assert node.announced
    assert {after - before for before, after in pairwise(ticks)} == {25_000_000}
    assert len(ticks) > 50
    transforms = [message.transforms[0].stamp for message in node.topics["/tf"].messages]
    assert stamps(node, ODOMETRY) == transforms == ticks
    assert stamps(node, SCAN) == ticks[::4]


def test_time_passes_at_the_requested_rate_and_a_pause_is_not_made_up_for(simulate, node, clock):
    def pause_from_one_to_two_seconds():
        node.services["/gazebo/pause_physics" if 1.0 <= clock.time < 2.0 else "/gazebo/unpause_physics"]()

    clock.events.append(pause_from_one_to_two_seconds)
    simulate(rate=4.0, seconds=3.0)
    assert stamps(node, "/clock")[-1] == pytest.approx(8.0e9, abs=1.2e9)


def test_lockstep_waits_for_the_command_that_answers_a_scan(simulate, node, capsys):
    answer_scans(node)
    simulate(lockstep=TIMEOUT)
    assert stamps(node, SCAN) == [number * 100_000_000 for number in range(6)]
    assert unanswered_scans(capsys) == 0


def test_lockstep_without_answers_repeats_the_scan_and_goes_on_after_the_timeout(simulate, node, capsys):
    simulate(lockstep=TIMEOUT, seconds=TIMEOUT + 5.0)
    assert stamps(node, SCAN)[:6] == [0] * 6, "every 5 s, because a program that has just joined can miss one"
    assert stamps(node, SCAN)[-1] == 100_000_000
    assert unanswered_scans(capsys) == 1


def test_in_lockstep_a_command_right_after_a_pause_answers_the_scan_before_it(simulate, node):
    def resume():
        node.services["/gazebo/pause_physics"]()
        node.services["/gazebo/unpause_physics"]()
        node.receive[VELOCITY](FORWARD)

    simulate(lockstep=TIMEOUT, seconds=1.0, before=resume)
    assert stamps(node, SCAN) == [0, 100_000_000], "one command, one scan"


def test_lockstep_stands_still_until_programs_are_connected(simulate, node, clock):
    for topic in (VELOCITY, NAVIGATION, SCAN):
        node.topics[topic].peers = False

    def connect():
        node.topics[SCAN].peers = clock.time >= 1.0
        if clock.time < 1.0:
            assert stamps(node, SCAN) == [], "no program receives it"
        if 3.5 < clock.time < 4.0:
            assert len(stamps(node, SCAN)) == 2, "one a second"
            assert len(node.topics["/tf"].messages) == pytest.approx(5 * clock.time, abs=2)
        if clock.time >= 4.0 and not node.topics[VELOCITY].peers:
            node.topics[VELOCITY].peers = True
            answer_scans(node, scans=8)

    clock.events.append(connect)
    simulate(lockstep=TIMEOUT)
    assert set(stamps(node, "/clock")[:15]) == {0}
    assert stamps(node, "/clock")[-1] > 0


def test_a_program_that_leaves_stops_the_lockstep_without_an_unanswered_scan(simulate, node, clock, capsys):
    clock.events.append(lambda: setattr(node.topics[SCAN], "peers", clock.time < 1.0))
    simulate(lockstep=TIMEOUT, seconds=40.0)
    assert set(stamps(node, "/clock")) == {0}
    assert unanswered_scans(capsys) == 0


def test_resets_put_the_robot_back_print_a_record_and_publish_a_scan_again(simulate, node, capsys):
    scans, odometry = node.topics[SCAN].messages, node.topics[ODOMETRY].messages
    services = {6: "/gazebo/reset_world", 7: "/gazebo/reset_simulation"}

    def react(scan):
        if len(scans) in services:
            node.services[services[len(scans)]]()
        elif len(scans) == 8:
            node.over = True
        else:
            node.receive[NAVIGATION](FORWARD)

    node.topics[SCAN].react = react
    simulate(lockstep=TIMEOUT)
    assert odometry[5].pose[0] > odometry[0].pose[0] + 0.1
    assert odometry[6].pose == odometry[0].pose
    assert (scans[6].stamp, scans[6].ranges.tolist()) == (scans[5].stamp, scans[0].ranges.tolist())
    assert scans[7].stamp == 0
    record, _ = capsys.readouterr().out.splitlines()
    assert record.startswith("from (-3.75, -3.75, 0.00): 0.5 s, 0.2 m, touched something 0 times, nearest range ")


def test_images_are_rendered_only_for_subscribers(simulate, node, clock, monkeypatch):
    rendered, images = [], SimulatedRobot.images
    monkeypatch.setattr(SimulatedRobot, "images", lambda self: rendered.append(clock.time) or images(self))
    depth = node.topics["/camera/depth/image_raw"]
    clock.events.append(lambda: setattr(depth, "peers", 0.4 < clock.time < 0.6))
    depth.peers = False
    simulate(rate=1.0, seconds=1.0)
    assert 1 <= len(rendered) == len(depth.messages) <= 3
    assert 0.4 <= min(rendered) < max(rendered) <= 0.62
    assert "/camera/rgb/image_raw" not in node.topics, "the kinematic simulator has no colours"

"""The classical local planners get to a target by their observations alone, and touch nothing."""

import math

import numpy as np
import pytest

from tb2rl import evaluate
from tb2rl.agents.dwa import DWA
from tb2rl.agents.pursuit import Pursuit
from tb2rl.agents.vfh import VFH
from tb2rl.core.errors import InputError
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.robots.vehicle import Vehicle
from tb2rl.runs.algorithm import make_baseline
from tb2rl.runs.config import resolve

WALL = [(1.0, y, 0.05) for y in np.arange(-3.0, 3.01, 0.05)]  # posts in a row
POLICIES = {"pursuit": Pursuit, "dwa": DWA, "vfh": VFH}


@pytest.fixture(params=POLICIES.values(), ids=POLICIES)
def policy(request):
    """The class of each planner."""
    return request.param


@pytest.mark.parametrize("target", [(2.0, 2.0), (-2.0, -0.5)])
def test_it_drives_to_a_free_target(policy, target, playground):
    path, _ = playground(target).drive(policy, steps=120)
    assert np.hypot(*(path[-1] - target)) < playground.GOAL_RADIUS
    assert np.hypot(*np.diff(path, axis=0).T).sum() < 1.3 * np.hypot(*target) + 0.5, "the path is short"


def test_it_does_not_touch_a_wall_before_its_target(policy, playground):
    path, clearance = playground((2.0, 0.0), WALL).drive(policy, steps=150)
    assert clearance > ROBOT.radius
    assert path[:, 0].max() > 0.3, "it drives towards the target"


def test_it_drives_round_a_post(policy, playground):
    path, clearance = playground((3.0, 0.0), [(1.2, 0.0, 0.2)]).drive(policy, steps=200)
    assert clearance > ROBOT.radius
    assert np.hypot(*(path[-1] - (3.0, 0.0))) < playground.GOAL_RADIUS


def test_a_goal_guides_as_a_waypoint_does(policy, playground):
    floors = [playground((1.2, 0.6), [(0.8, -0.3, 0.2)], guide=guide) for guide in ("plan", "goal")]
    actions = [floor.policy(policy).predict(floor.observe(speeds=(0.3, 0.2)))[0] for floor in floors]
    np.testing.assert_allclose(*actions, atol=1e-5)


def test_it_drives_by_the_latest_of_stacked_frames(policy, playground):
    one, three = (playground((1.0, 0.5), frame_stack=frame_stack) for frame_stack in (1, 3))
    now, before = one.observe(), one.observe(pose=(0.3, 0.3, 2.0))
    action = one.policy(policy).predict(now)[0]
    np.testing.assert_array_equal(three.policy(policy).predict(np.concatenate([before, before, now]))[0], action)
    assert not np.array_equal(one.policy(policy).predict(before)[0], action)


def test_a_batch_of_robots_acts_as_each_of_them_alone(policy, playground):
    rng, floor = np.random.default_rng(0), playground((1.2, 0.4), [(0.9, 0.0, 0.2), (0.5, 0.8, 0.1)])
    poses = np.column_stack([rng.uniform(-0.3, 0.3, (20, 2)), rng.uniform(-3.0, 3.0, 20)])
    observations = np.array([floor.observe(pose, (rng.uniform(0, 0.65), rng.uniform(-2, 2))) for pose in poses])
    planner = floor.policy(policy)
    together = planner.predict(observations)[0]
    assert together.shape == (20, 2)
    assert len(np.unique(together, axis=0)) > 5
    np.testing.assert_array_equal(together, [planner.predict(one)[0] for one in observations])
    assert (np.abs(together) <= 1.0).all()


@pytest.mark.parametrize(
    ("task", "settings", "message"),
    [
        ("drive", {}, "vfh needs a laser, the robot's speeds and a goal or a waypoint"),
        ("navigate", {"world": "wall", "named_actions": True}, "task.named_actions=false"),
        ("navigate", {"world": "wall", "beams": 1}, "vfh needs 2 beams or more"),
        (
            "navigate",
            {"world": "wall", "observe": ("laser", "waypoint", "imu")},
            "twist, waypoint.*got laser, waypoint",
        ),
    ],
)
def test_missing_observations_and_named_actions_are_refused(task, settings, message):
    scene = make_scene(make_task(task, settings), "raw")
    with pytest.raises(InputError, match=message):
        VFH(scene.observation_space, scene.action_space)


@pytest.mark.parametrize(
    "laser", [{"robot": "turtlebot3", "field_of_view": None}, {"beams": 180, "beam_indices": [0, 30, 60, 90, 120]}]
)
def test_it_knows_the_directions_of_its_beams(laser, playground):
    config = resolve("vfh", "navigate", settings={"task.world": "wall", **{f"task.{k}": v for k, v in laser.items()}})
    ranges = np.arange(1.0, 1.0 + len(config.scene.laser.angles))
    numbers = np.zeros((1, *config.scene.observation_space.shape))
    numbers[0, : len(ranges)] = ranges
    view = make_baseline(config)._view(numbers)
    bearings = np.arctan2(*view.points[0].T[::-1])
    np.testing.assert_allclose(np.cos(bearings - config.scene.laser.angles), 1.0)
    with pytest.raises(InputError, match="each with a direction, got 60 and 2"):
        playground((1.0, 0.0)).policy(Pursuit, vehicle=Vehicle(directions=(0.0, 1.0)))


@pytest.mark.parametrize(("name", "robot"), [("pursuit", "turtlebot2"), ("dwa", "jackal"), ("vfh", "turtlebot2")])
def test_it_drives_by_its_name_within_the_limits_of_the_robot(name, robot):
    config = resolve(name, "navigate", settings={"task.robot": robot, "task.world": "wall", "agent.gap": 0.03})
    policy = make_baseline(config)
    fastest = config.scene.actions.commands(np.ones((1, 2)))
    np.testing.assert_array_equal(fastest, [[policy.vehicle.max_speed, policy.vehicle.max_turn_rate]])
    assert (policy.vehicle.radius, policy.vehicle.period) == (config.scene.robot.radius, config.task.control_period)
    assert evaluate(policy, config, episodes=1, steps=20, workers=1).summary()["failure_free_rate"] == 1.0


def test_its_vehicle_is_no_setting():
    with pytest.raises(InputError, match="unknown key of agent 'vehicle'"):
        resolve("dwa", "navigate", settings={"task.world": "wall", "agent.vehicle": {}})


# ---- pure pursuit


@pytest.mark.parametrize("target", [(1.2, 0.5), (1.4, -0.2), (0.6, 0.6)])
def test_pursuits_arc_leads_to_the_target(target, playground):
    v, w = playground(target).command(Pursuit, speeds=(0.5, 0.0))
    assert w / v == pytest.approx(2.0 * target[1] / np.hypot(*target) ** 2, rel=1e-4)


def test_pursuit_is_slow_on_sharp_arcs_and_towards_obstacles(playground):
    straight = playground((1.4, 0.0)).command(Pursuit)[0]
    bent = playground((0.1, 0.4)).command(Pursuit)[0]
    near = playground((1.4, 0.0), [(0.7, 0.0, 0.3)]).command(Pursuit, bends=0)[0]
    assert straight == pytest.approx(0.65)
    assert 0.0 < near < bent < straight


def test_pursuit_turns_on_the_spot_to_a_target_behind(playground):
    for side in (-1.0, 1.0):
        v, w = playground((-1.0, 0.3 * side)).command(Pursuit)
        assert v == pytest.approx(0.0, abs=1e-6)
        assert w * side > 0.5


def test_pursuit_bends_round_a_post_and_without_bends_it_slows_down(playground):
    floor = playground((1.4, 0.0), [(0.6, 0.05, 0.2)])
    straight, bent = (floor.command(Pursuit, speeds=(0.3, 0.0), bends=bends) for bends in (0, 16))
    assert straight[0] < 0.5
    assert straight[1] == pytest.approx(0.0, abs=1e-6)
    assert bent[0] > straight[0]
    assert bent[1] < -0.2


# ---- the dynamic window approach


@pytest.mark.parametrize("speeds", [(0.0, 0.0), (0.3, 1.0), (0.65, -2.0)])
def test_dwa_commands_reachable_speeds(speeds, playground):
    for target in ((1.5, 0.0), (0.0, 1.0), (-1.0, -0.5)):
        v, w = playground(target).command(DWA, speeds, acceleration=1.0, turn_acceleration=6.0)
        assert abs(v - speeds[0]) <= 0.1 + 1e-6
        assert abs(w - speeds[1]) <= 0.6 + 1e-6


def test_dwa_accelerates_to_full_speed(playground):
    path, _ = playground((4.0, 0.0)).drive(DWA, steps=30)
    steps = np.hypot(*np.diff(path, axis=0).T)
    assert steps[0] == pytest.approx(0.01, abs=0.002)
    assert steps[-1] == pytest.approx(0.065, abs=0.002)


@pytest.mark.parametrize("v", [0.2, 0.4, 0.65])
def test_dwa_brakes_while_it_still_can(v, playground):
    gap, brakes = 0.04, v * 0.1 + v**2 / 2.0
    for free in np.arange(0.05, 0.6, 0.05):
        wall = [(free + ROBOT.radius + gap + 0.05, y, 0.05) for y in np.arange(-1.5, 1.51, 0.04)]
        commanded = playground((3.0, 0.0), wall).command(DWA, (v, 0.0), gap=gap)[0]
        assert commanded <= v - 0.1 + 1e-6 or brakes - 0.11 <= free


def test_dwas_weights_decide_between_target_and_speed(playground):
    floor = playground((0.0, 1.5))
    aims = floor.command(DWA, (0.3, 0.0), heading=5.0, speed=0.0, progress=0.0, clearance=0.0)
    hurries = floor.command(DWA, (0.3, 0.0), heading=0.0, speed=5.0, progress=0.0, clearance=0.0)
    assert aims[1] == pytest.approx(0.6, abs=1e-5)
    assert hurries[0] == pytest.approx(0.4, abs=1e-5)


def test_dwa_rotates_away_from_a_wall_to_one_side(playground):
    wall = [(0.3, y, 0.05) for y in np.arange(-0.5, 0.51, 0.04)]
    floor = playground((1.5, 0.0), wall)
    for turn in (-1.0, 1.0):
        v, w = floor.command(DWA, (0.0, turn))
        assert v == pytest.approx(0.0, abs=1e-6)
        assert w == pytest.approx(2.0 * turn)


# ---- VFH+


def side_walls(width: float) -> list[tuple[float, float, float]]:
    """A wall across the path, 1 m ahead, with a door of this width in the middle [m]."""
    ends = np.arange(width / 2.0 + 0.05, 3.0, 0.05)
    return [(1.0, side * y, 0.05) for y in ends for side in (-1.0, 1.0)]


def test_vfh_turns_to_a_free_target_at_its_gain(playground):
    direction = math.radians(23.0)
    target = (1.5 * math.cos(direction), 1.5 * math.sin(direction))
    v, w = playground(target).command(VFH, gain=2.0, spin=1.0)
    assert w == pytest.approx(2.0 * direction, rel=1e-4)
    assert v == pytest.approx(0.65 * (1.0 - direction), rel=1e-4)


def test_vfh_passes_a_door_as_wide_as_it_needs(playground):
    for width, passes in ((0.3, False), (0.6, True)):
        path, clearance = playground((2.5, 0.3), side_walls(width)).drive(VFH, steps=150)
        assert clearance > 0.178
        assert (path[:, 0].max() > 1.5) == passes


def test_vfh_takes_the_middle_of_a_narrow_valley(playground):
    walls = [(x, side * 0.45, 0.05) for x in np.arange(0.0, 2.0, 0.05) for side in (-1.0, 1.0)]
    v, w = playground((1.4, 0.3), walls).command(VFH)
    assert abs(w) < 0.1
    assert v > 0.5


def test_vfh_keeps_turning_to_the_same_side(playground):
    wall = [(0.35, y, 0.05) for y in np.arange(-1.0, 1.01, 0.04)]
    floor = playground((1.5, 0.0), wall)
    for turn in (-1.0, 1.0):
        assert floor.command(VFH, (0.0, turn))[1] * turn > 1.0


def test_vfh_prefers_the_previous_direction(playground):
    floor = playground((1.5, 0.0), [(0.7, 0.0, 0.1)])
    assert floor.command(VFH, (0.5, 1.5))[1] > 0.5
    assert floor.command(VFH, (0.5, -1.5))[1] < -0.5

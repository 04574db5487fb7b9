"""The classical local planners get to a target by their observations alone, and touch nothing."""

from __future__ import annotations

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
from tb2rl.runs.layers import resolve

WALL = [(1.0, y, 0.05) for y in np.arange(-3.0, 3.01, 0.05)]  # posts in a row
POLICIES = {"pursuit": Pursuit, "dwa": DWA, "vfh": VFH}


@pytest.fixture(params=POLICIES)
def name(request):
    """The name of each planner."""
    return request.param


@pytest.fixture
def policy(name):
    """The class of each planner."""
    return POLICIES[name]


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
        ("drive", {}, "where to go, as task navigate says"),
        ("navigate", {"world": "wall", "named_actions": True}, "task.named_actions=false"),
        ("navigate", {"world": "wall", "beams": 1}, "2 beams"),
        ("navigate", {"world": "wall", "observe": ("laser", "goal")}, "or observe waypoint"),
        ("navigate", {"world": "wall", "observe": ("laser", "waypoint", "imu")}, "add twist to task.observe"),
    ],
)
def test_missing_observations_and_named_actions_are_refused(task, settings, message):
    scene = make_scene(make_task(task, settings), "raw")
    with pytest.raises(InputError, match=message) as refused:
        VFH(scene.observation_space, scene.action_space)
    assert "vfh" in str(refused.value)


@pytest.mark.parametrize(
    "laser", [{"robot": "turtlebot3", "field_of_view": None}, {"beams": 180, "beam_indices": [0, 30, 60, 90, 120]}]
)
def test_it_knows_the_directions_of_its_beams(laser, playground):
    config = resolve("vfh", "navigate", settings={"task.world": "wall", **{f"task.{k}": v for k, v in laser.items()}})
    ranges = np.arange(1.0, 1.0 + len(config.scene.laser.angles))
    view = make_baseline(config)._view(np.array([[*ranges, *np.zeros(config.scene.observation_space.shape[0])]]))
    bearings = np.arctan2(*view.points[0].T[::-1])
    np.testing.assert_allclose(np.cos(bearings - config.scene.laser.angles), 1.0)
    with pytest.raises(InputError, match="directions of its 60 beams, got 2"):
        playground((1.0, 0.0)).policy(Pursuit, vehicle=Vehicle(directions=(0.0, 1.0)))


@pytest.mark.parametrize("robot", ["turtlebot2", "jackal"])
def test_it_drives_by_its_name_within_the_limits_of_the_robot(name, robot):
    config = resolve(name, "navigate", settings={"task.robot": robot, "task.world": "wall", "agent.gap": 0.03})
    policy = make_baseline(config)
    assert policy.max_speed == pytest.approx(min(config.task.max_speed, config.scene.robot.max_speed))
    fastest = config.scene.actions.commands(np.ones((1, 2)))
    np.testing.assert_array_equal(fastest, [[policy.max_speed, policy.turn_rate]])
    assert evaluate(policy, config, episodes=1, steps=20, workers=1).summary()["failure_free_rate"] == 1.0


def test_it_is_given_its_vehicle_which_is_no_setting():
    settings = {"task.robot": "jackal", "task.world": "wall", "task.max_speed": 2.0, "task.turn_rate": 1.0}
    policy = make_baseline(resolve("dwa", "navigate", settings=settings))
    assert (policy.max_speed, policy.turn_rate, policy.radius, policy.period) == (2.0, 1.0, 0.26, 0.1)
    with pytest.raises(InputError, match="unknown key of agent 'vehicle'"):
        resolve("dwa", "navigate", settings={**settings, "agent.vehicle": {}})

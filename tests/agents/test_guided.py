"""Three classical navigators get to a target by what they observe, and touch nothing."""

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
POLICIES = [Pursuit, DWA, VFH]


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("target", [(3.0, 0.0), (2.0, 2.0), (-2.0, -0.5)])
def test_it_drives_to_a_free_target(policy, target, playground):
    path, _ = playground(target).drive(policy, steps=120)
    assert np.hypot(*(path[-1] - target)) < playground.GOAL_RADIUS
    assert np.hypot(*np.diff(path, axis=0).T).sum() < 1.3 * np.hypot(*target) + 0.5, "it takes a short way"


@pytest.mark.parametrize("policy", POLICIES)
def test_it_does_not_touch_a_wall_before_its_target(policy, playground):
    path, clearance = playground((2.0, 0.0), WALL).drive(policy, steps=150)
    assert clearance > ROBOT.radius
    assert path[:, 0].max() > 0.3, "it was on its way"


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("post", [(1.2, 0.0, 0.2), (1.2, 0.1, 0.3), (1.5, -0.1, 0.2)])
def test_it_goes_round_a_post(policy, post, playground):
    path, clearance = playground((3.0, 0.0), [post]).drive(policy, steps=200)
    assert clearance > ROBOT.radius
    assert np.hypot(*(path[-1] - (3.0, 0.0))) < playground.GOAL_RADIUS


@pytest.mark.parametrize("policy", POLICIES)
def test_a_goal_guides_as_a_waypoint_does(policy, playground):
    floors = [playground((1.2, 0.6), [(0.8, -0.3, 0.2)], guide=guide) for guide in ("plan", "goal")]
    actions = [floor.policy(policy).predict(floor.observe(speeds=(0.3, 0.2)))[0] for floor in floors]
    np.testing.assert_allclose(*actions, atol=1e-5)


@pytest.mark.parametrize("policy", POLICIES)
def test_it_drives_by_the_latest_of_several_frames(policy, playground):
    one, three = (playground((1.0, 0.5), frame_stack=frame_stack) for frame_stack in (1, 3))
    now, before = one.observe(), one.observe(pose=(0.3, 0.3, 2.0))
    action = one.policy(policy).predict(now)[0]
    np.testing.assert_array_equal(three.policy(policy).predict(np.concatenate([before, before, now]))[0], action)
    assert not np.array_equal(one.policy(policy).predict(before)[0], action)


@pytest.mark.parametrize("policy", POLICIES)
def test_many_robots_act_as_each_of_them_alone(policy, playground):
    rng, floor = np.random.default_rng(0), playground((1.2, 0.4), [(0.9, 0.0, 0.2), (0.5, 0.8, 0.1)])
    poses = np.column_stack([rng.uniform(-0.3, 0.3, (50, 2)), rng.uniform(-3.0, 3.0, 50)])
    seen = np.array([floor.observe(pose, (rng.uniform(0, 0.65), rng.uniform(-2, 2))) for pose in poses])
    drives = floor.policy(policy)
    together = drives.predict(seen)[0]
    assert together.shape == (50, 2)
    assert len(np.unique(together, axis=0)) > 10
    np.testing.assert_array_equal(together, [drives.predict(one)[0] for one in seen])
    assert (np.abs(together) <= 1.0).all()


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize(
    ("task", "settings", "named"),
    [
        ("drive", {}, "where to go, as task navigate says"),
        ("wall", {}, "where to go, as task navigate says"),
        ("navigate", {"world": "wall", "named_actions": True}, "task.named_actions=false"),
        ("navigate", {"world": "wall", "beams": 1}, "2 beams"),
        ("navigate", {"world": "wall", "observe": ("laser", "goal")}, "or observe waypoint"),
        ("navigate", {"world": "wall", "observe": ("laser", "waypoint", "imu")}, "add twist to task.observe"),
    ],
)
def test_it_refuses_what_it_cannot_drive_by(policy, task, settings, named, playground):
    scene = make_scene(make_task(task, settings), "raw")
    with pytest.raises(InputError, match=named) as refused:
        policy(scene.observation_space, scene.action_space)
    assert policy.__name__.lower() in str(refused.value)


@pytest.mark.parametrize("name", ["pursuit", "dwa", "vfh"])
@pytest.mark.parametrize(
    "laser", [{"robot": "turtlebot3", "field_of_view": None}, {"beams": 180, "beam_indices": [0, 30, 60, 90, 120]}]
)
def test_it_knows_where_its_beams_look(name, laser):
    config = resolve(name, "navigate", settings={"task.world": "wall", **{f"task.{k}": v for k, v in laser.items()}})
    ranges = np.arange(1.0, 1.0 + len(config.scene.laser.angles))
    seen = make_baseline(config)._seen(np.array([[*ranges, *np.zeros(config.scene.observation_space.shape[0])]]))
    bearings = np.arctan2(*seen.points[0].T[::-1])
    np.testing.assert_allclose(np.cos(bearings - config.scene.laser.angles), 1.0)


def test_it_says_how_many_directions_it_needs(playground):
    with pytest.raises(InputError, match="directions of its 60 beams, got 2"):
        playground((1.0, 0.0)).policy(Pursuit, vehicle=Vehicle(directions=(0.0, 1.0)))


@pytest.mark.parametrize("name", ["pursuit", "dwa", "vfh"])
@pytest.mark.parametrize("robot", ["turtlebot2", "turtlebot3", "jackal"])
def test_it_drives_by_its_name_within_what_the_robot_can_do(name, robot):
    settings = {"task.robot": robot, "task.world": "wall", "agent.gap": 0.03}
    config = resolve(name, "navigate", settings=settings)
    policy = make_baseline(config)
    assert policy.max_speed == pytest.approx(min(config.task.max_speed, config.scene.robot.max_speed))
    summary = evaluate(policy, config, episodes=2, steps=30, workers=1).summary()
    assert summary["failure_free_rate"] == 1.0


@pytest.mark.parametrize("name", ["pursuit", "dwa", "vfh"])
def test_action_1_is_what_the_robot_can_do_where_the_task_is_faster(name):
    config = resolve(name, "navigate", settings={"task.robot": "turtlebot3", "task.world": "wall"})
    policy = make_baseline(config)
    np.testing.assert_array_equal(
        config.scene.actions.commands(np.ones((1, 2))), [[policy.max_speed, policy.turn_rate]]
    )
    assert policy.max_speed == 0.22


@pytest.mark.parametrize("name", ["pursuit", "dwa", "vfh"])
def test_it_is_told_what_its_robot_and_task_are(name):
    settings = {"task.robot": "jackal", "task.world": "wall", "task.max_speed": 2.0, "task.turn_rate": 1.0}
    policy = make_baseline(resolve(name, "navigate", settings=settings))
    assert (policy.max_speed, policy.turn_rate, policy.radius, policy.period) == (2.0, 1.0, 0.26, 0.1)
    with pytest.raises(InputError, match="unknown key of agent 'vehicle'"):
        resolve(name, "navigate", settings={**settings, "agent.vehicle": {}})

"""A collision with a dynamic obstacle is an ending of its own, in every task that ends in collisions."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.tasks.drive import Drive
from tb2rl.tasks.navigate import Navigate
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.task import COLLISION, DYNAMIC_COLLISION
from tb2rl.tasks.wander import Wander

PERSON_AHEAD = np.tile((0.4, 0.0, 1.0, 0.0, 0.2, 0.0), (4, 1, 1))  # an outline in each of four environments
TASKS = (Wander(), Drive(), ReachGoal())


@pytest.fixture
def robot_state(make_robot_state):
    """Far from everything, at a wall, near a dynamic obstacle, and touched by one."""
    moving = np.array([True, False, True, True])
    return make_robot_state(
        [3.0, 0.4, 0.4, 3.0], bumped=[False, False, False, True], nearest_is_dynamic=moving, goal=(5.0, 5.0)
    )


def first_actions(task, num_envs):
    space = task.actions.space
    return np.zeros((num_envs, *(space.shape or ())), space.dtype)


@pytest.mark.parametrize("task", TASKS, ids=lambda task: type(task).__name__)
def test_an_ending_names_what_the_robot_touched(task, robot_state, make_robot_state):
    outcome = task.outcome(robot_state, first_actions(task, 4), robot_state)
    endings = [outcome.ending(i, timed_out=True) for i in range(4)]
    assert [ending.name for ending in endings] == ["time limit", COLLISION, DYNAMIC_COLLISION, DYNAMIC_COLLISION]
    assert all(ending.failed and not ending.success for ending in endings[1:])
    assert (outcome.reward[1:] == task.collision_reward).all()
    static = make_robot_state([3.0, 0.1], goal=(5.0, 5.0))
    failed = task.outcome(static, first_actions(task, 2), static).failed
    assert DYNAMIC_COLLISION not in failed, "where nothing moves there is one kind"
    assert failed[COLLISION].tolist() == [False, True]


@pytest.fixture
def driven_to_goal(robot_state):
    """A function to the states before and after a step: from a speed [m/s], with a commanded speed [m/s].

    `obstacles` are outlines (4, obstacles, 6).
    """

    def states(speed, commanded, obstacles=PERSON_AHEAD):
        first = replace(robot_state, dynamic_obstacles=obstacles, twist=np.tile((speed, 0.5), (4, 1)))
        last = replace(robot_state, dynamic_obstacles=obstacles, command=np.tile((commanded, 0.5), (4, 1)))
        for each in (first, last):
            vars(each)["path_length"] = np.full(4, 3.0)  # found before: these states come from no simulator
        return first, last

    return states


@pytest.mark.parametrize(
    ("speed", "commanded", "bearing", "failed"),
    [
        (0.0, 0.0, 0, False),
        (0.0, 0.3, 0, True),
        (0.3, 0.0, 0, True),
        (0.3, 0.3, 80, True),
        (0.3, 0.3, -80, True),
        (0.3, 0.3, 100, False),
        (0.3, 0.3, 180, False),
    ],
)
def test_navigate_fails_if_the_robot_drives_towards_what_it_touches(speed, commanded, bearing, failed, driven_to_goal):
    x, y = math.cos(math.radians(bearing)), math.sin(math.radians(bearing))
    person = (0.4 * x, 0.4 * y, 1.0, 0.0, 0.25, 0.0)
    long_box = (0.4 * x - 1.5 * y, 0.4 * y + 1.5 * x, -y, x, 2.0, 0.2)  # its side there, its middle elsewhere
    for touched in (person, long_box):
        others = [(-x, -y, 1.0, 0.0, 0.0, 0.0), (-3.0 * x, -3.0 * y, 1.0, 0.0, 0.25, 0.0)]
        first, last = driven_to_goal(speed, commanded, np.tile([*others, touched], (4, 1, 1)))
        ending = Navigate().outcome(first, np.zeros((4, 2), np.float32), last).ending(3, timed_out=False)
        assert (ending and (ending.name, ending.failed)) == ((DYNAMIC_COLLISION, True) if failed else None)


def test_a_goal_is_not_reached_while_a_dynamic_obstacle_touches_the_robot(driven_to_goal):
    first, last = driven_to_goal(0.0, 0.0)
    there = replace(last, pose=np.column_stack([last.goal, last.pose[:, 2]]))
    vars(there)["path_length"] = np.zeros(4)
    outcome = Navigate().outcome(first, np.zeros((4, 2), np.float32), there)
    assert outcome.succeeded["goal"].tolist() == [True, True, True, False]
    assert not outcome.terminated[3]


@pytest.mark.parametrize(("kind", "earned"), [(Wander, 5.0), (Drive, 0.0)])
def test_a_step_near_a_wall_costs_the_square_of_the_nearness(kind, earned, make_robot_state):
    radius = ROBOT.radius
    after = make_robot_state([radius, radius + 0.1, radius + 0.2, 3.0, radius], bumped=[False] * 4 + [True])
    task = kind(collision_range=0.0, margin=0.2, margin_reward=-4.0, collision_reward=-9.0)
    action = first_actions(task, 5)
    rewards = task.outcome(after, action, after).reward
    assert rewards == pytest.approx([earned - 4.0, earned - 1.0, earned, earned, -9.0])
    assert kind(collision_range=0.0).outcome(after, action, after).reward[:4].tolist() == [earned] * 4

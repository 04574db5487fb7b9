"""A crash with something that moves is an ending of its own, in every task that knows crashes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.tasks import collision_endings
from tb2rl.tasks.drive import Drive
from tb2rl.tasks.navigate import Navigate
from tb2rl.tasks.outcome import COLLISION, OBSTACLE_COLLISION
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander

SOMEBODY_AHEAD = np.tile((0.4, 0.0, 1.0, 0.0, 0.2, 0.0), (4, 1, 1))  # an outline for each of four robots
TASKS = (Wander(), Drive(), ReachGoal())


@pytest.fixture
def robot_state(make_reading):
    """Four robots: one far from all, one at a wall, one near something that moves, one that something ran into."""
    moving = np.array([True, False, True, True])
    return make_reading(
        [3.0, 0.4, 0.4, 3.0], bumped=[False, False, False, True], nearest_is_dynamic=moving, goal=(5.0, 5.0)
    )


@pytest.mark.parametrize("task", TASKS, ids=lambda task: type(task).__name__)
def test_an_ending_says_with_what_the_robot_crashed(task, robot_state):
    action = np.zeros((4, *(task.actions.space.shape or ())), task.actions.space.dtype)
    outcome = task.outcome(robot_state, action, robot_state)
    endings = [outcome.ending(robot, timed_out=True) for robot in range(4)]
    assert [ending.name for ending in endings[1:]] == [COLLISION, OBSTACLE_COLLISION, OBSTACLE_COLLISION]
    assert all(ending.failed and not ending.success for ending in endings[1:])
    assert endings[0].name == "time limit"
    assert outcome.endings(np.arange(4)) == endings
    assert (outcome.reward[1:] == task.collision_reward).all()
    assert outcome.terminated.tolist() == [False, True, True, True]


@pytest.mark.parametrize("task", TASKS, ids=lambda task: type(task).__name__)
def test_where_nothing_moves_there_is_one_crash(task, make_reading):
    robot_state = make_reading([3.0, 0.1], goal=(5.0, 5.0))
    action = np.zeros((2, *(task.actions.space.shape or ())), task.actions.space.dtype)
    failed = task.outcome(robot_state, action, robot_state).failed
    assert OBSTACLE_COLLISION not in failed
    assert failed[COLLISION].tolist() == [False, True]


def test_a_task_of_ones_own_tells_crashes_apart_with_one_call(robot_state):
    failed = collision_endings(robot_state.bumped, robot_state)
    assert failed[COLLISION].tolist() == [False] * 4
    assert failed[OBSTACLE_COLLISION].tolist() == [False, False, False, True]


@pytest.mark.parametrize(
    ("before", "told", "bearing", "at_fault"),
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
@pytest.mark.parametrize("shape", ["person", "long box"])
def test_at_navigate_who_drives_towards_what_it_touches_has_crashed(
    before, told, bearing, at_fault, shape, robot_state, driven_to_goal
):
    x, y = math.cos(math.radians(bearing)), math.sin(math.radians(bearing))
    touched = {
        "person": (0.4 * x, 0.4 * y, 1.0, 0.0, 0.25, 0.0),
        "long box": (0.4 * x - 1.5 * y, 0.4 * y + 1.5 * x, -y, x, 2.0, 0.2),  # its side there, its middle elsewhere
    }[shape]
    beside = np.tile([(-x, -y, 1.0, 0.0, 0.0, 0.0), (-3.0 * x, -3.0 * y, 1.0, 0.0, 0.25, 0.0), touched], (4, 1, 1))
    first, last = driven_to_goal(robot_state, before, told, beside)
    ending = Navigate().outcome(first, np.zeros((4, 2), np.float32), last).ending(3, timed_out=False)
    assert (ending and (ending.name, ending.failed)) == ((OBSTACLE_COLLISION, True) if at_fault else None)


def test_a_robot_that_stands_at_the_goal_is_not_there_while_something_touches_it(robot_state, driven_to_goal):
    first, last = driven_to_goal(robot_state, 0.0, 0.0)
    there = replace(last, pose=np.column_stack([last.goal, last.pose[:, 2]]))
    vars(there)["path_length"] = np.zeros(4)
    outcome = Navigate().outcome(first, np.zeros((4, 2), np.float32), there)
    assert outcome.succeeded["goal"].tolist() == [True, True, True, False]
    assert not outcome.terminated[3]


@pytest.fixture
def driven_to_goal():
    """A function that gives a reading before and after a step: at so many metres per second, and told to be so fast.

    `beside` are outlines of what moves, (4, movers, 6): usually somebody ahead.
    """

    def of(robot_state, speed, told, beside=SOMEBODY_AHEAD):
        first = replace(robot_state, dynamic_obstacles=beside, twist=np.tile((speed, 0.5), (4, 1)))
        last = replace(robot_state, dynamic_obstacles=beside, command=np.tile((told, 0.5), (4, 1)))
        for each in (first, last):
            vars(each)["path_length"] = np.full(4, 3.0)  # found before: these readings come from no simulation
        return first, last

    return of


@pytest.mark.parametrize(("kind", "earned"), [(Wander, 5.0), (Drive, 0.0)])
def test_a_step_near_a_wall_is_fined_by_the_square_of_how_near(kind, earned, make_reading):
    radius = ROBOT.radius
    after = make_reading([radius, radius + 0.1, radius + 0.2, 3.0, radius], bumped=[False] * 4 + [True])
    task = kind(collision_range=0.0, margin=0.2, margin_reward=-4.0, collision_reward=-9.0)
    action = np.zeros((5, *(task.actions.space.shape or ())), task.actions.space.dtype)
    fined = task.outcome(after, action, after).reward
    assert fined == pytest.approx([earned - 4.0, earned - 1.0, earned, earned, -9.0])
    assert kind(collision_range=0.0).outcome(after, action, after).reward[:4].tolist() == [earned] * 4

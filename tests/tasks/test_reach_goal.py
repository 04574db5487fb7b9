"""TurtleBot2Wall: the rules of the tutorial, and the source of the goal."""

import numpy as np
import pytest

from tb2rl.simulation.random_streams import GeneratorSource
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.worlds.description import parse_world

TUTORIAL = {"goal": (5.0, 0.0), "bounds": (-1.0, -3.0, 6.0, 3.0)}
TASK = ReachGoal(goal_tolerance=0.05)
RULES = [  # place before and after a step, its reward, ending, and whether it is a success
    ((0, 0), (0.1, 0), 5 + 5, None, False),  # closer
    ((0.1, 0), (0, 0), 5, None, False),  # farther
    ((4.9, 0), (4.96, 0.04), 200, "goal", True),
    ((4.9, 0), (4.96, 0.06), 5 + 5, None, False),  # near enough in x only
    ((4.9, 0), (4.94, 0.0), 5 + 5, None, False),  # near enough in y only
    ((5.9, 0), (6.01, 0), -200, "out of bounds", False),
    ((0, 2.9), (0, 3.01), -200, "out of bounds", False),
    ((5.9, 2.9), (6.0, 3.0), 5, None, False),  # (-1, 6] and (-3, 3]: the upper bounds belong to it,
    ((-0.9, 0), (-1.0, 0), -200, "out of bounds", False),  # the lower ones do not
    ((0, -2.9), (0, -3.0), -200, "out of bounds", False),
]


@pytest.fixture
def initial_state_of(make_spec):
    """A function from a task and a world to the initial states of two environments."""

    def initial_state(task, world):
        return task.initial_state(make_spec(world), GeneratorSource(np.random.default_rng(0), 2))

    return initial_state


@pytest.mark.parametrize(("before", "after", "reward", "ending", "success"), RULES)
def test_rewards_and_endings_follow_the_tutorial(before, after, reward, ending, success, make_robot_state):
    first, last = make_robot_state(pose=(*before, 0), **TUTORIAL), make_robot_state(pose=(*after, 0), **TUTORIAL)
    outcome = TASK.outcome(first, np.array([0]), last)
    assert outcome.reward == [reward]
    assert outcome.terminated == [ending is not None]
    found = outcome.ending(0, timed_out=False)
    assert (found and (found.name, found.success, found.failed)) == (ending and (ending, success, not success))


def test_a_collision_at_the_goal_is_a_collision(make_robot_state):
    after = make_robot_state([0.4, 3.0], bumped=[False, True], pose=(5, 0, 0), **TUTORIAL)
    outcome = TASK.outcome(after, np.array([0, 0]), after)
    assert outcome.reward.tolist() == [-200, -200]
    endings = [outcome.ending(i, timed_out=False) for i in (0, 1)]
    assert {(ending.name, ending.success, ending.failed) for ending in endings} == {("collision", False, True)}


def test_goal_and_bounds_are_those_of_the_world_or_of_the_settings(initial_state_of):
    usual = initial_state_of(ReachGoal(), "wall")
    assert usual.goal.tolist() == [[5.0, 0.0]] * 2
    assert usual.bounds.tolist() == [[-1.0, -3.0, 6.0, 3.0]] * 2
    set_here = initial_state_of(ReachGoal(goal=(1.0, 2.0), bounds=(0.0, 0.0, 3.0, 3.0)), "loop")
    assert set_here.goal.tolist() == [[1.0, 2.0]] * 2
    assert set_here.bounds.tolist() == [[0.0, 0.0, 3.0, 3.0]] * 2
    world = parse_world({"start": [0, 0, 0], "goal": [3, 1, 1.5], "bounds": [-5, -5, 5, 5]}, "mine")
    assert initial_state_of(ReachGoal(), world).goal.tolist() == [[3, 1]] * 2

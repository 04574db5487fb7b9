"""Tasks judge readings of several robots at once; here the readings are made by hand."""

import math

import numpy as np
import pytest

from tb2rl.envs import TurtleBot2Env
from tb2rl.errors import InputError
from tb2rl.maze import load_maze
from tb2rl.registry import find_task, task_names
from tb2rl.robot import within_limits
from tb2rl.simulation import Reading
from tb2rl.tasks import Outcome
from tb2rl.tasks.my_turtlebot2_maze import MyTurtleBot2Maze
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander

FAR, INF = 3.0, math.inf


def reading(nearest=FAR, bumped=False, pose=(0.0, 0.0, 0.0), odometry=None):
    """A reading of as many robots as the longest argument has; a single value is the same for all."""
    poses = np.atleast_2d(np.array(pose, dtype=float))
    robots = max(len(poses), np.size(nearest), np.size(bumped))
    poses = np.broadcast_to(poses, (robots, 3))
    ranges = np.full((robots, 3), INF)
    ranges[:, 1] = nearest
    return Reading(
        pose=poses,
        twist=np.zeros((robots, 2)),
        odometry=poses if odometry is None else np.atleast_2d(np.array(odometry, dtype=float)),
        ranges=ranges,
        bumped=np.broadcast_to(np.array(bumped), robots),
    )


def judge(task, action, after, before=None):
    return task.judge(before or after, np.array(action), after)


# ---- every task


@pytest.mark.parametrize("name", task_names())
def test_every_task_tells_the_robot_what_it_can_do(name):
    commands = find_task(name)().commands
    assert commands.shape[1:] == (2,)
    assert (within_limits(commands) == commands).all()


@pytest.mark.parametrize("name", task_names())
def test_every_task_judges_several_robots_as_it_would_each_alone(name):
    task, rng, robots = find_task(name)(), np.random.default_rng(0), 200
    task = task.placed(load_maze(task.maze))
    poses = rng.uniform((-2, -4, -3), (7, 4, 3), (2, robots, 3))
    nearest, bumped = rng.uniform(0.1, 4, robots), rng.random(robots) < 0.2
    action = rng.integers(len(task.commands), size=robots)
    together = judge(task, action, reading(nearest, bumped, poses[1]), reading(nearest, bumped, poses[0]))
    assert together.reward.shape == together.terminated.shape == (robots,)
    assert together.terminated.any()
    assert not together.terminated.all()
    for i in range(robots):
        before, after = (reading(nearest[i], bumped[i], pose[i]) for pose in poses)
        alone = judge(task, action[i : i + 1], after, before)
        assert alone.reward == together.reward[i]
        assert alone.terminated == together.terminated[i]
        assert {reason: bool(where[0]) for reason, where in alone.endings.items()} == {
            reason: where[i] for reason, where in together.endings.items()
        }


def test_an_outcome_without_endings_ends_nothing():
    assert Outcome(reward=np.zeros(2)).terminated.tolist() == [False, False]


# ---- Wander


def test_wander_pays_for_going_straight_and_a_little_for_turning():
    outcome = judge(Wander(), [Wander.FORWARD, Wander.LEFT, Wander.RIGHT], reading([FAR, 0.51, INF]))
    assert outcome.reward.tolist() == [5, 1, 1]
    assert not outcome.terminated.any()
    assert Wander().commands.tolist() == [[0.5, 0], [0.05, 1], [0.05, -1]]  # left is counter-clockwise


def test_a_crash_replaces_the_reward_of_the_robot_that_crashed_only():
    outcome = judge(Wander(), [0, 0, 1, 0], reading([0.49, 0.51, 0.3, FAR], bumped=[False, False, False, True]))
    assert outcome.reward.tolist() == [-200, 5, -200, -200]
    assert outcome.endings["crash"].tolist() == [True, False, True, True]
    assert outcome.terminated.tolist() == [True, False, True, True]
    assert outcome.success is None


def test_wanders_numbers_are_settings():
    task = Wander(crash_range=1.0, crash_reward=-1.0, forward_reward=0.1, turn_reward=0.0, turn_rate=0.3)
    assert judge(task, [0, 1, 0], reading([FAR, FAR, 0.9])).reward.tolist() == [0.1, 0, -1]
    assert task.commands[1:, 1].tolist() == [0.3, -0.3]


# ---- MyTurtleBot2Maze


def test_my_turtlebot2_maze_has_a_fourth_action_that_costs():
    task = MyTurtleBot2Maze()
    outcome = judge(task, [0, 1, 2, 3, 3], reading([FAR, FAR, FAR, FAR, 0.4]))
    assert outcome.reward.tolist() == [5, 1, 1, -5, -200]
    assert outcome.endings["crash"].tolist() == [False] * 4 + [True]
    assert task.commands[3].tolist() == [-0.05, 0]


# ---- ReachGoal

TUTORIAL = {"goal": (5.0, 0.0), "goal_tolerance": 0.05, "bounds": (-1.0, -3.0, 6.0, 3.0)}


@pytest.mark.parametrize(
    ("before", "after", "reward", "ending", "success"),
    [
        ((0, 0), (0.1, 0), 5 + 5, None, False),  # closer
        ((0.1, 0), (0, 0), 5, None, False),  # farther
        ((0, 0), (0, 0), 5, None, False),  # as far as before
        ((4.9, 0), (4.96, 0.04), 200, "goal", True),
        ((4.9, 0), (5.04, -0.04), 200, "goal", True),
        ((4.9, 0), (4.96, 0.06), 5 + 5, None, False),  # near enough in x only
        ((4.9, 0), (4.94, 0.0), 5 + 5, None, False),  # near enough in y only
        ((5.9, 0), (6.01, 0), -200, "out of bounds", False),
        ((-0.9, 0), (-1.01, 0), -200, "out of bounds", False),
        ((0, 2.9), (0, 3.01), -200, "out of bounds", False),
        ((0, -2.9), (0, -3.01), -200, "out of bounds", False),
        ((5.9, 2.9), (6.0, 3.0), 5, None, False),  # (-1, 6] and (-3, 3]: the upper bounds belong to it,
        ((-0.9, 0), (-1.0, 0), -200, "out of bounds", False),  # the lower ones do not
        ((0, -2.9), (0, -3.0), -200, "out of bounds", False),
    ],
)
def test_reach_goal_follows_the_rules_of_the_tutorial(before, after, reward, ending, success):
    outcome = judge(ReachGoal(**TUTORIAL), [0], reading(pose=(*after, 0)), reading(pose=(*before, 0)))
    assert outcome.reward == [reward]
    assert [reason for reason, where in outcome.endings.items() if where[0]] == ([ending] if ending else [])
    assert outcome.terminated == [ending is not None]
    assert outcome.success == [success]


def test_a_turn_that_comes_closer_is_paid_as_a_turn_and_as_closer():
    after, before = reading(pose=(0.1, 0, 0)), reading(pose=(0, 0, 0))
    assert judge(ReachGoal(**TUTORIAL), [ReachGoal.LEFT], after, before).reward == [1 + 5]


def test_a_crash_at_the_goal_is_a_crash():
    outcome = judge(ReachGoal(**TUTORIAL), [0, 0], reading([0.4, FAR], bumped=[False, True], pose=(5, 0, 0)))
    assert outcome.reward.tolist() == [-200, -200]
    assert outcome.success.tolist() == [False, False]
    assert next(reason for reason, where in outcome.endings.items() if where[0]) == "crash"


@pytest.mark.parametrize(
    ("pose", "distance", "bearing"),
    [
        ((0, 0, 0), 5, 0),
        ((5, -2, 0), 2, math.pi / 2),  # to the left: positive
        ((5, 2, 0), 2, -math.pi / 2),
        ((5, -2, math.pi / 2), 2, 0),
        ((4, -1, math.pi), math.sqrt(2), -3 * math.pi / 4),
        ((4, -1, -math.pi / 2), math.sqrt(2), 3 * math.pi / 4),
        ((4, 0, 3.0), 1, -3.0),
        ((4, 0, -3.0), 1, 3.0),
        ((6, 0, 3.0), 1, math.pi - 3.0),
        ((6, 0, -3.0), 1, 3.0 - math.pi),
    ],
)
def test_reach_goal_senses_where_the_goal_is_by_its_odometry(pose, distance, bearing):
    lost = reading(pose=(-7, 8, 1), odometry=pose)
    assert ReachGoal(**TUTORIAL).sense(lost) == pytest.approx(np.array([[distance, bearing]]))


def test_a_sensed_bearing_stays_within_its_limits():
    task, yaws = ReachGoal(**TUTORIAL), np.linspace(-math.pi, math.pi, 1001)
    bearings = task.sense(reading(pose=[(0, 0, yaw) for yaw in yaws]))[:, 1]
    bearing = task.senses[1]
    assert ((bearings >= bearing.low) & (bearings <= bearing.high)).all()


def test_reach_goal_takes_goal_and_bounds_from_its_maze_unless_it_is_told():
    maze = load_maze("wall")
    placed = ReachGoal().placed(maze)
    assert (placed.goal, placed.bounds) == ((5.0, 0.0), (-1.0, -3.0, 6.0, 3.0))
    told = ReachGoal(goal=(1.0, 2.0), bounds=(0.0, 0.0, 3.0, 3.0)).placed(maze)
    assert (told.goal, told.bounds) == ((1.0, 2.0), (0.0, 0.0, 3.0, 3.0))


def test_reach_goal_in_a_maze_without_a_goal_says_what_to_set():
    with pytest.raises(InputError, match=r"maze loop has no goal; set task\.goal"):
        ReachGoal().placed(load_maze("loop"))


# ---- a task of one's own

OWN_TASK = """
from dataclasses import dataclass

import numpy as np

from tb2rl.tasks import Outcome, Sense, Task


@dataclass(frozen=True)
class Spin(Task):
    rate: float = 1.0

    @property
    def commands(self):
        return np.array([(0.0, self.rate), (0.0, -self.rate)])

    @property
    def senses(self):
        return (Sense("turn rate", -4.0, 4.0, edges=(0.0,)),)

    def sense(self, reading):
        return reading.twist[:, 1:]

    def judge(self, before, action, after):
        return Outcome(reward=abs(after.twist[:, 1]), endings={"dizzy": abs(after.twist[:, 1]) > 3.0})
"""


@pytest.fixture
def own_module(tmp_path, monkeypatch):
    (tmp_path / "my_own_task.py").write_text(OWN_TASK)
    monkeypatch.syspath_prepend(tmp_path)
    return "my_own_task"


@pytest.mark.parametrize("observation", ["discrete", "raw"])
def test_a_task_of_ones_own_is_one_class_in_a_module_of_ones_own(own_module, observation):
    env = TurtleBot2Env(f"{own_module}:Spin", observation, rate=2.0, maze="circuit", episode_steps=5)
    assert env.action_space.n == 2
    env.reset(seed=0)
    for action, sign in ((0, 1), (1, -1)):
        env.step(action)
        seen, reward, terminated, _, info = env.step(action)
        assert reward == pytest.approx(2.0, rel=0.02)
        assert seen[-1] == (sign > 0 if observation == "discrete" else pytest.approx(sign * 2.0, rel=0.02))
        assert (terminated, info["ended"]) == (False, None)
        assert env.observation_space.contains(seen)
    env.close()


def test_a_task_of_ones_own_ends_for_its_own_reason(own_module):
    env = TurtleBot2Env(f"{own_module}:Spin", rate=3.1)
    env.reset(seed=0)
    endings = [env.step(0)[4]["ended"] for _ in range(5)]
    env.close()
    assert endings[-1] == "dizzy"


@pytest.mark.parametrize(
    ("task", "words"),
    [
        ("mase", ["unknown task 'mase'", "did you mean 'maze'", "my-maze", "wall"]),
        ("no_such_module:Spin", ["no module 'no_such_module'"]),
        ("my_own_task:Spun", ["my_own_task", "has no 'Spun'"]),
        ("my_own_task:Outcome", ["not a class derived from tb2rl.tasks.Task"]),
    ],
)
def test_a_task_that_does_not_exist_is_refused(own_module, task, words):
    with pytest.raises(InputError) as error:
        TurtleBot2Env(task)
    for word in words:
        assert word in str(error.value)

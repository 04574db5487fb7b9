"""A task whose methods return a wrong value is refused in one line, before anything drives or learns."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.sensors import Sensor
from tb2rl.sensors.goal import GoalDistance
from tb2rl.simulation import InitialState
from tb2rl.tasks import Commands, Outcome
from tb2rl.tasks.wander import Wander


def wander(**methods):
    """Wander with some of its methods or attributes replaced."""
    return dataclass(frozen=True)(type("Errand", (Wander,), methods))()


def with_outcome(outcome):
    """Wander whose `outcome` returns what the function `outcome` makes of the latest state."""
    return wander(outcome=lambda self, before, action, after: outcome(after))


def sensing(sensors):
    """Wander that observes `sensors`."""
    return wander(sensors=lambda self, spec: sensors)


class Sides(Sensor):
    """The ranges to the right and to the left."""

    name, unit, low, high, shape = "sides", "m", 0.0, 30.0, (2,)

    def read(self, robot_state):
        return robot_state.ranges[:, [0, -1]]


def sides(**attributes):
    return sensing((type("Changed", (Sides,), attributes)(),))


def begun(change):
    """Wander whose initial state a function changes."""

    def initial_state(self, spec, random):
        start = Wander.initial_state(self, spec, random)
        return change(start) or start

    return wander(initial_state=initial_state)


def put(array, value):
    array[:] = value


REFUSED = [
    (with_outcome(lambda after: Outcome(1.0)), "reward must be float, shape .num_envs,.; got 1"),
    (with_outcome(lambda after: None), "task Errand: outcome must return an Outcome; got None"),
    (
        with_outcome(lambda after: Outcome(after.nearest_range, after.bumped)),
        'outcome must return failed={"name": mask',
    ),
    (wander(actions=lambda self: Commands(go=(1, 0))), "@property is missing above it"),
    (wander(initial_state=lambda self, spec, random: None), "initial_state must return an InitialState; got None"),
    (begun(lambda start: InitialState(start.table[:1])), r"random.num_envs rows.* shape \(1, 33\)"),
    (begun(lambda start: put(start.world, 1)), "initial_state must use indices of worlds, below 1; got .1.0"),
    (sensing(Sides()), r"sensors must return a tuple: \(Compass\(\),\); got <"),
    (sensing((Sides,)), r"sensors must return sensors: write Sides\(\); got <class"),
    (sides(shape=2), r"shape must be a tuple of counts, such as \(1,\); got 2"),
    (sides(low=31.0), r"low and high must be numbers, low the smaller one; got \(31.0, 30.0\)"),
    (sides(shape=(3,)), r"shape \('num_envs', 3\), float, not NaN; got an array of float64, shape \(2, 2\)"),
    (sides(shape=(1, 1, 1), read=lambda self, robot_state: np.zeros((2, 1, 1, 1))), "uint8, not NaN"),
    (sensing((GoalDistance(),)), "goal distance must read an array of .* float, not NaN"),
]


@pytest.mark.parametrize(("task", "words"), REFUSED, ids=[words[:40] for _, words in REFUSED])
def test_a_wrong_return_value_is_refused_in_one_line(task, words):
    with pytest.raises(InputError, match=words) as error:
        make_scene(task, "raw")
    assert "\n" not in str(error.value)


@dataclass(frozen=True)
class Eastward(Wander):
    """Get one metre to the east of the goal's place."""

    goal_task: ClassVar[bool] = True
    reports: ClassVar[bool] = True

    def outcome(self, before, action, after):
        reached = {"goal": after.pose[:, 0] > after.goal[:, 0] + 1.0}
        return replace(super().outcome(before, action, after), succeeded=reached if self.reports else None)


def test_a_goal_task_of_ones_own_works_where_there_is_a_goal():
    assert make_scene(Eastward(world="wall"), "raw").goal_in(0) == (5.0, 0.0)


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (Eastward(world="loop"), r"world loop has no goal; set initial_state\.goal in initial_state"),
        (type("Silent", (Eastward,), {"reports": False})(world="wall"), "task Silent: goal_task is True, so .* succ"),
        (type("Shy", (Eastward,), {"goal_task": False})(), "task Shy: .* with succeeded, so set goal_task = True"),
    ],
)
def test_goal_task_and_outcome_must_agree(task, words):
    with pytest.raises(InputError, match=words):
        make_scene(task, "raw")


def test_a_method_written_for_one_robot_fails_with_one_robot_too():
    def outcome(self, before, action, after):
        return Outcome(after.nearest_range, {"collision": after.bumped} if after.bumped else {})

    with pytest.raises(ValueError, match="truth value of an array") as error:
        make_env(wander(outcome=outcome))
    assert not isinstance(error.value, InputError)
    assert error.traceback[-1].name == "outcome"


@pytest.mark.parametrize("name", ["pose", "ranges", "goal"])
def test_a_method_that_writes_into_a_robot_state_fails(name):
    with pytest.raises(ValueError, match="read-only"):
        make_scene(with_outcome(lambda after: put(getattr(after, name), 0)), "raw")

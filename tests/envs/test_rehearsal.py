"""A task whose methods return what they must not is refused with one line, before anything is driven or learned."""

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
from tb2rl.tasks import Commands, Outcome, Velocities
from tb2rl.tasks.wander import Wander


def wander(**methods):
    """Wander with some of its methods or attributes replaced."""
    return dataclass(frozen=True)(type("Errand", (Wander,), methods))()


def judged(outcome):
    """Wander whose `outcome` returns what the function `outcome` makes of the latest reading."""
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
    """Wander whose start a function changes."""

    def initial_state(self, spec, draws):
        start = Wander.initial_state(self, spec, draws)
        return change(start) or start

    return wander(initial_state=initial_state)


def put(array, value):
    array[:] = value


REFUSED = {
    "a reward for all robots together": (judged(lambda after: Outcome(1.0)), "reward must have shape .robots,.; got 1"),
    "rewards in a column": (judged(lambda after: Outcome(after.twist[:, :1])), r"reward .*; got .*shape \(2, 1\)"),
    "rewards that are names": (judged(lambda after: Outcome(np.array(["a", "b"]))), "reward .*; got an array of <U1"),
    "no return from outcome": (judged(lambda after: None), "task Errand: outcome must return an Outcome; got None"),
    "an array from outcome": (
        judged(lambda after: after.nearest),
        r"an Outcome; got an array of float64, shape \(2,\)",
    ),
    "a mask for all endings": (
        judged(lambda after: Outcome(after.nearest, after.bumped)),
        'outcome must return failed={"name": mask',
    ),
    "a float mask": (judged(lambda after: Outcome(after.nearest, {"hit": after.nearest})), r"failed\['hit'\] .* bool"),
    "a mask for all successes": (
        judged(lambda after: Outcome(after.nearest, succeeded=after.bumped)),
        'return succeeded={"name": mask}; got an array of bool',
    ),
    "one mask for all robots": (judged(lambda after: Outcome(after.nearest, {"hit": True})), "'hit'.* bool.*got True"),
    "actions without @property": (wander(actions=lambda self: Commands(go=(1, 0))), "@property is missing above it"),
    "actions that are a dict": (wander(actions={"go": (1, 0)}), "actions must be Commands or Velocities; got {'go'"),
    "no return from begin": (
        wander(initial_state=lambda self, spec, draws: None),
        "initial_state must return a Start; got None",
    ),
    "a start for one robot": (
        begun(lambda start: InitialState(start.table[:1])),
        r"draws.robots rows.* shape \(1, 33\)",
    ),
    "a world that is not there": (
        begun(lambda start: put(start.world, 1)),
        "initial_state must name worlds by index, below 1; got .1.0",
    ),
    "a pose that is NaN": (
        begun(lambda start: put(start.pose, np.nan)),
        "initial_state must return finite poses; got ..nan",
    ),
    "one sensor and no tuple": (sensing(Sides()), r"sensors must return a tuple: \(Compass\(\),\); got <"),
    "the class of a sensor": (sensing((Sides,)), r"sensors must return sensors: write Sides\(\); got <class"),
    "a sensor that is a string": (sensing(("sides",)), "sensors must return sensors; got 'sides'"),
    "no name": (sides(name=None), "sensor Changed: name and unit must be strings; got .None, 'm'"),
    "a unit that is a number": (sides(unit=1), "name and unit must be strings; got .'sides', 1"),
    "a shape that is a number": (sides(shape=2), r"shape must be a tuple of counts, such as \(1,\); got 2"),
    "a shape of 0": (sides(shape=(0,)), r"shape must be a tuple of counts, such as \(1,\); got \(0,\)"),
    "one edge and no tuple": (sides(bins=0.5), "bins must be a tuple of numbers; got 0.5"),
    "edges that are strings": (sides(bins=("near",)), "bins must be a tuple of numbers; got .'near'"),
    "low above high": (sides(low=31.0), r"low and high must be numbers, low the smaller one; got \(31.0, 30.0\)"),
    "no low": (sides(low=None), r"low and high must be numbers, low the smaller one; got \(None, 30.0\)"),
    "fewer values than its shape": (
        sides(shape=(3,)),
        r"shape \('robots', 3\), float, not NaN; got an array of float64, shape \(2, 2\)",
    ),
    "values in a list": (
        sides(read=lambda self, robot_state: [[0, 0], [0, 0]]),
        r"sides must read an array .* got \[\[0, 0",
    ),
    "an image of floats": (
        sides(shape=(1, 1, 1), read=lambda self, robot_state: np.zeros((2, 1, 1, 1))),
        "uint8, not NaN",
    ),
    "no goal to be far from": (sensing((GoalDistance(),)), "goal distance must read an array of .* float, not NaN"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_a_task_returns_wrongly_is_refused_with_one_line(what):
    task, words = REFUSED[what]
    with pytest.raises(InputError, match=words) as error:
        make_scene(task, "raw")
    assert "\n" not in str(error.value)


# ---- goals


@dataclass(frozen=True)
class Eastward(Wander):
    """Get one metre to the east of the goal's place."""

    goal_task: ClassVar[bool] = True
    told: ClassVar[bool] = True

    def outcome(self, before, action, after):
        reached = {"goal": after.pose[:, 0] > after.goal[:, 0] + 1.0}
        return replace(super().outcome(before, action, after), succeeded=reached if self.told else None)


def test_a_goal_task_of_ones_own_works_where_there_is_a_goal():
    assert make_scene(Eastward(world="wall"), "raw").goal == (5.0, 0.0)


@pytest.mark.parametrize(
    ("task", "words"),
    [
        (
            Eastward(world="loop"),
            r"world loop has no goal; set initial_state\.goal in initial_state, or a goal in the world's file",
        ),
        (
            type("Silent", (Eastward,), {"told": False})(world="wall"),
            "task Silent: goal_task is True, so outcome .* succ",
        ),
        (type("Shy", (Eastward,), {"goal_task": False})(), "task Shy: .* with succeeded, so set goal_task = True"),
    ],
)
def test_what_a_goal_task_says_of_its_goal_must_agree(task, words):
    with pytest.raises(InputError, match=words):
        make_scene(task, "raw")


# ---- what goes wrong inside of a method is the user's to see


def test_a_method_written_for_one_robot_fails_with_one_robot_too():
    def outcome(self, before, action, after):
        return Outcome(after.nearest, {"collision": after.bumped} if after.bumped else {})

    with pytest.raises(ValueError, match="truth value of an array") as error:
        make_env(wander(outcome=outcome))
    assert not isinstance(error.value, InputError)
    assert error.traceback[-1].name == "outcome"


@pytest.mark.parametrize("name", ["pose", "twist", "odometry", "ranges", "bumped", "goal", "nearest"])
def test_a_method_that_writes_into_a_reading_fails(name):
    with pytest.raises(ValueError, match="read-only"):
        make_scene(judged(lambda after: put(getattr(after, name), 0)), "raw")


def test_a_rehearsal_warns_of_nothing_and_leaves_the_start_to_the_task():
    def outcome(self, before, action, after):
        return Outcome(1.0 / after.twist[:, 0], {"collision": after.bumped})

    starts = []
    make_scene(
        wander(
            outcome=outcome,
            initial_state=lambda self, spec, draws: starts.append(InitialState.default(spec, 2)) or starts[0],
        ),
        "raw",
    )
    starts[0].pose[:] = 0.0


@pytest.mark.parametrize("actions", [Velocities(forward=(0.0, 0.5), turn=(-1.0, 1.0)), Commands(go=(0.5, 0.0))])
def test_judge_is_rehearsed_with_actions_of_the_right_shape(actions):
    seen = []

    def outcome(self, before, action, after):
        seen.append(action)
        return Outcome(after.nearest, {"collision": after.bumped})

    make_scene(wander(actions=actions, outcome=outcome), "raw")
    assert seen[0].shape == (2, *actions.space.shape)
    assert actions.commands(seen[0]).shape == (2, 2)


def test_a_task_may_ask_where_movers_are_if_there_are_some():
    def outcome(self, before, action, after):
        near = np.hypot(*(after.dynamic_obstacles[:, :, :2] - after.pose[:, None, :2]).transpose(2, 0, 1)).min(axis=1)
        return Outcome(near, failed={"met": after.nearest_is_dynamic & after.bumped})

    assert make_scene(
        replace(wander(outcome=outcome), dynamic_obstacles={"people": 1}), "raw"
    ).spec.has_dynamic_obstacles

"""What every task keeps to, and a task of one's own."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import task_names
from tb2rl.core.values import build
from tb2rl.robots.registry import find_robot
from tb2rl.robots.robot import WHEEL_ACCELERATION
from tb2rl.simulation.random_streams import GeneratorDraws, StreamDraws
from tb2rl.simulation.spec import BOUNDS, GOAL, OBSTACLE_SEED, POSE, WORLD
from tb2rl.tasks import Commands
from tb2rl.tasks.registry import find_task
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.dynamic_obstacles import find_dynamic_obstacles
from tb2rl.worlds.registry import find_world


def draws(num_envs=1, seed=0):
    return GeneratorDraws(np.random.default_rng(seed), num_envs)


def world_of(name):
    """The world of a task; one, where the task has many."""
    world = find_task(name)().world
    return "maze" if world == "mixed" else world


# ---- every task


@pytest.mark.parametrize("name", task_names())
def test_every_task_tells_the_robot_what_it_can_do(name):
    task = find_task(name)()
    actions = task.actions
    some = np.arange(actions.space.n) if isinstance(actions, Commands) else np.array([[-1.0, -1.0], [1.0, 1.0]])
    commands = actions.commands(some)
    assert commands.shape == (len(some), 2)
    assert (find_robot(task.robot).within_limits(commands) == commands).all()


@pytest.mark.parametrize("name", task_names())
def test_every_task_judges_several_robots_as_it_would_each_alone(name, make_reading, make_setup):
    task, rng, num_envs = find_task(name)(), np.random.default_rng(0), 200
    spec = make_setup(world_of(name))
    start = task.initial_state(spec.within(0), draws())
    ways = SimpleNamespace(spec=spec)  # of the simulation that readings come from
    aim = {"goal": start.goal[0], "bounds": start.bounds[0], "eye": ways}
    poses = rng.uniform((-2, -4, -3), (7, 4, 3), (2, num_envs, 3))
    nearest, bumped = rng.uniform(0.1, 4, num_envs), rng.random(num_envs) < 0.2
    task.actions.space.seed(0)
    action = np.array([task.actions.space.sample() for _ in range(num_envs)])
    before, after = (make_reading(nearest, bumped=bumped, pose=pose, **aim) for pose in poses)
    together = task.outcome(before, action, after)
    assert together.reward.shape == together.terminated.shape == (num_envs,)
    assert together.terminated.any()
    assert not together.terminated.all()
    assert (together.succeeded is not None) == task.goal_task
    for i in range(num_envs):
        before, after = (make_reading(nearest[i], bumped=bumped[i], pose=pose[i], **aim) for pose in poses)
        alone = task.outcome(before, action[i : i + 1], after)
        assert alone.reward == together.reward[i]
        assert alone.terminated == together.terminated[i]
        for endings, of_all in ((alone.failed, together.failed), (alone.succeeded or {}, together.succeeded or {})):
            assert {name: bool(here[0]) for name, here in endings.items()} == {n: w[i] for n, w in of_all.items()}
        assert alone.ending(0, timed_out=True) == together.ending(i, timed_out=True)


@pytest.mark.parametrize("name", task_names())
def test_every_task_begins_anywhere_or_at_the_start_of_its_world(name, make_setup):
    spec = make_setup(world_of(name))
    (world,) = spec.worlds
    random = find_task(name)(start_clearance=0.5).initial_state(spec, draws(100))
    assert len(np.unique(random.pose, axis=0)) == 100
    assert min(world.clearance(x, y) for x, y, _ in random.pose) >= 0.5 - 1e-3
    fixed = find_task(name)(start="fixed").initial_state(spec, draws(3))
    assert fixed.pose.tolist() == [list(world.start)] * 3
    assert (fixed.world == 0).all()


@pytest.mark.parametrize("name", task_names())
def test_where_a_robot_begins_depends_on_its_own_stream_alone(name, make_setup):
    task, keys = find_task(name)(), np.arange(5, dtype=np.uint64)
    spec = make_setup(world_of(name))
    together = task.initial_state(spec, StreamDraws(keys, np.zeros(5, np.uint64)))
    alone = task.initial_state(spec, StreamDraws(keys[3:4], np.zeros(1, np.uint64)))
    np.testing.assert_array_equal(together.table[3], alone.table[0])
    assert len(np.unique(together.pose, axis=0)) == 5


def test_a_random_start_follows_from_the_seed(make_setup):
    spec = make_setup("loop")
    poses = [Wander().initial_state(spec, draws(4, seed)).pose for seed in (1, 1, 2)]
    assert (poses[0] == poses[1]).all()
    assert (poses[0] != poses[2]).all()


def test_every_task_observes_the_laser_first(make_setup):
    for name in task_names():
        task = find_task(name)()
        first, *_ = task.sensors(make_setup(world_of(name), beams=5))
        assert (first.name, first.unit, first.shape, first.bins) == ("laser", "m", (5,), task.range_bins)


@pytest.mark.parametrize("name", task_names())
def test_a_varied_robot_begins_where_any_other_would(name, make_setup):
    task, spec, keys = find_task(name), make_setup(world_of(name)), np.arange(5, dtype=np.uint64)
    plain = task().initial_state(spec, StreamDraws(keys, np.zeros(5, np.uint64)))
    none, strong = (
        task(variation=preset).randomized_initial_state(spec, StreamDraws(keys, np.zeros(5, np.uint64)))
        for preset in ("none", "strong")
    )
    np.testing.assert_array_equal(none.table, plain.table)
    for column in (POSE, WORLD, GOAL, BOUNDS):
        np.testing.assert_array_equal(strong.table[:, column], plain.table[:, column])
    assert (strong.parameters[:, WHEEL_ACCELERATION] != plain.parameters[:, WHEEL_ACCELERATION]).all()


@pytest.mark.parametrize("variation", ["none", "strong"])
@pytest.mark.parametrize("name", task_names())
def test_movers_change_nothing_that_was_drawn_before_them(name, variation, make_setup):
    task, keys = find_task(name)(variation=variation), np.arange(5, dtype=np.uint64)
    bare = make_setup(world_of(name))
    moving = replace(bare, dynamic_obstacles=find_dynamic_obstacles({"people": 1}, "dynamic_obstacles"))
    alone, among = (
        task.randomized_initial_state(spec, StreamDraws(keys, np.zeros(5, np.uint64))).table for spec in (bare, moving)
    )
    np.testing.assert_array_equal(among[:, :OBSTACLE_SEED], alone[:, :OBSTACLE_SEED])
    assert (alone[:, OBSTACLE_SEED] == 0).all()
    assert len(np.unique(among[:, OBSTACLE_SEED])) == 5


# ---- a task of one's own

OWN_TASK = """
from dataclasses import dataclass

import numpy as np

from tb2rl.sensors import Sensor
from tb2rl.tasks import Commands, Outcome, Task


class TurnRate(Sensor):
    name, unit = "turn rate", "rad/s"
    low, high = -4.0, 4.0
    bins = (0.0,)

    def read(self, reading):
        return reading.twist[:, 1:]


@dataclass(frozen=True)
class Spin(Task):
    rate: float = 1.0

    @property
    def actions(self):
        return Commands(left=(0.0, self.rate), right=(0.0, -self.rate))

    def sensors(self, setup):
        return (*super().sensors(setup), TurnRate())

    def outcome(self, before, action, after):
        rate = abs(after.twist[:, 1])
        return Outcome(reward=rate, failed={"dizzy": rate > 3.0})


class Forgot(Task):
    rate: float = 1.0
    actions = Commands(left=(0.0, 1.0))

    def outcome(self, before, action, after):
        return Outcome(reward=after.twist[:, 1])


@dataclass(frozen=True)
class Half(Task):
    actions = Commands(left=(0.0, 1.0))
"""


@pytest.fixture
def own_module(tmp_path, monkeypatch):
    (tmp_path / "my_own_task.py").write_text(OWN_TASK)
    monkeypatch.syspath_prepend(tmp_path)
    return "my_own_task"


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize("observation", ["discrete", "raw"])
def test_a_task_of_ones_own_is_one_class_in_a_module_of_ones_own(own_module, observation, simulation):
    settings = {"rate": 2.0, "world": "circuit", "episode_steps": 5}
    env = make_env(f"{own_module}:Spin", observation, simulation=simulation, **settings)
    assert env.action_space.n == 2
    env.reset(seed=0)
    for action, sign in ((0, 1), (1, -1)):
        for _ in range(2):
            seen, reward, terminated, _, info = env.step(action)
        assert reward == pytest.approx(2.0, rel=0.02)
        assert seen[-1] == (sign > 0 if observation == "discrete" else pytest.approx(sign * 2.0, rel=0.02))
        assert (terminated, info["ended"], info["failed"]) == (False, "", False)
        assert env.observation_space.contains(seen)
    env.close()


def test_a_task_of_ones_own_ends_for_its_own_reason(own_module):
    env = make_env(f"{own_module}:Spin", rate=3.1)
    env.reset(seed=0)
    infos = [env.step(0)[4] for _ in range(5)]
    env.close()
    assert (infos[-1]["ended"], infos[-1]["failed"], infos[-1]["is_success"]) == ("dizzy", True, False)


@pytest.mark.parametrize(
    ("task", "words"),
    [
        ("mase", ["unknown task 'mase'", "did you mean 'maze'", "my-maze", "wall"]),
        ("no_such_module:Spin", ["no module 'no_such_module'"]),
        ("my_own_task:Spun", ["my_own_task", "has no 'Spun'"]),
        ("my_own_task:Outcome", ["not a class derived from tb2rl.tasks.Task"]),
        ("my_own_task:Half", ["not a class derived from tb2rl.tasks.Task with actions and judge"]),
        ("my_own_task:Forgot", ["has the settings rate", "@dataclass(frozen=True)"]),
    ],
)
def test_a_task_that_does_not_exist_is_refused(own_module, task, words):
    with pytest.raises(InputError) as error:
        make_env(task)
    for word in words:
        assert word in str(error.value)


@dataclass(frozen=True)
class _Untyped(Wander):
    bonus = 5.0


def test_a_setting_without_a_type_is_refused_by_what_it_lacks():
    for set_it in (lambda: make_env(_Untyped, bonus=2.0), lambda: build(_Untyped, {"bonus": 2.0}, "task")):
        with pytest.raises(InputError, match=r"task\.bonus: a setting needs a type .* write bonus: float = "):
            set_it()
    with pytest.raises(InputError, match="unknown key of task 'goal_task'"):
        build(_Untyped, {"goal_task": True}, "task")


@pytest.mark.parametrize("settings", [{"world": find_world("loop")}, {"robot": find_robot("turtlebot2")}])
def test_an_object_in_place_of_its_name_is_refused_with_the_way_to_name_it(settings):
    ((key, value),) = settings.items()
    with pytest.raises(InputError) as error:
        make_env(**settings)
    way = 'must be a name, or "module:NAME" of what a file of yours defines'
    assert str(error.value) == f"task.{key}: {way}, got an object of class {type(value).__name__}"

"""The promises of every task, and a task of one's own."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import task_names
from tb2rl.core.values import build
from tb2rl.robots.robot import find_robot
from tb2rl.simulation.random_streams import GeneratorSource, StreamSource
from tb2rl.tasks import Commands
from tb2rl.tasks.task import find_task
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.dynamic_obstacles import parse_dynamic_obstacles
from tb2rl.worlds.registry import find_world


def random_source(num_envs=1, seed=0):
    return GeneratorSource(np.random.default_rng(seed), num_envs)


def world_of(name):
    """The world of a task; one, where the task has many."""
    world = find_task(name)().world
    return "maze" if world == "mixed" else world


@pytest.mark.parametrize("name", task_names())
def test_every_task_commands_what_its_robot_can_do_and_observes_the_laser_first(name, make_spec):
    task = find_task(name)()
    ends = np.arange(task.actions.space.n) if isinstance(task.actions, Commands) else np.array([[-1.0] * 2, [1.0] * 2])
    commands = task.actions.commands(ends)
    assert commands.shape == (len(ends), 2)
    assert (find_robot(task.robot).clip_commands(commands) == commands).all()
    first, *_ = task.sensors(make_spec(world_of(name), beams=5))
    assert (first.name, first.unit, first.shape, first.bins) == ("laser", "m", (5,), task.range_bins)


@pytest.mark.parametrize("name", task_names())
def test_outcomes_of_several_environments_are_those_of_each_alone(name, make_robot_state, make_spec):
    task, rng, num_envs = find_task(name)(), np.random.default_rng(0), 60
    spec = make_spec(world_of(name))
    start = task.initial_state(spec.for_world(0), random_source())
    aim = {"goal": start.goal[0], "bounds": start.bounds[0], "simulator": SimpleNamespace(spec=spec)}
    poses = rng.uniform((-2, -4, -3), (7, 4, 3), (2, num_envs, 3))
    nearest, bumped = rng.uniform(0.1, 4, num_envs), rng.random(num_envs) < 0.2
    task.actions.space.seed(0)
    action = np.array([task.actions.space.sample() for _ in range(num_envs)])
    before, after = (make_robot_state(nearest, bumped=bumped, pose=pose, **aim) for pose in poses)
    together = task.outcome(before, action, after)
    assert together.reward.shape == together.terminated.shape == (num_envs,)
    assert together.terminated.any()
    assert not together.terminated.all()
    assert (together.succeeded is not None) == task.goal_task
    for i in range(num_envs):
        before, after = (make_robot_state(nearest[i], bumped=bumped[i], pose=pose[i], **aim) for pose in poses)
        alone = task.outcome(before, action[i : i + 1], after)
        assert alone.reward == together.reward[i]
        assert alone.terminated == together.terminated[i]
        assert alone.ending(0, timed_out=True) == together.ending(i, timed_out=True)


@pytest.mark.parametrize("name", task_names())
def test_every_task_begins_anywhere_or_at_the_start_of_its_world(name, make_spec):
    spec = make_spec(world_of(name))
    (world,) = spec.worlds
    states = find_task(name)(start_clearance=0.5).initial_state(spec, random_source(100))
    assert len(np.unique(states.pose, axis=0)) == 100
    assert min(world.clearance(x, y) for x, y, _ in states.pose) >= 0.5 - 1e-3
    fixed = find_task(name)(start="fixed").initial_state(spec, random_source(3))
    assert fixed.pose.tolist() == [list(world.start)] * 3
    assert (fixed.world == 0).all()


@pytest.mark.parametrize("name", task_names())
def test_an_initial_state_depends_on_its_own_stream_alone_and_variation_moves_nothing(name, make_spec):
    spec, keys = make_spec(world_of(name)), np.arange(5, dtype=np.uint64)

    def draw(keys, **settings):
        task = find_task(name)(**settings)
        return task.randomized_initial_state(spec, StreamSource(keys, np.zeros(len(keys), np.uint64)))

    plain, strong = draw(keys), draw(keys, variation="strong")
    np.testing.assert_array_equal(draw(keys[3:4]).table[0], plain.table[3])
    assert len(np.unique(plain.pose, axis=0)) == 5
    for field in ("pose", "world", "goal", "bounds"):
        np.testing.assert_array_equal(getattr(strong, field), getattr(plain, field))
    assert (strong.table != plain.table).any(axis=1).all()


@pytest.mark.parametrize("variation", ["none", "strong"])
def test_dynamic_obstacles_change_nothing_that_was_drawn_before_them(variation, make_spec):
    task, keys, bare = Wander(variation=variation), np.arange(5, dtype=np.uint64), make_spec("loop")
    moving = replace(bare, dynamic_obstacles=parse_dynamic_obstacles({"people": 1}, "dynamic_obstacles"))
    alone, among = (
        task.randomized_initial_state(spec, StreamSource(keys, np.zeros(5, np.uint64))) for spec in (bare, moving)
    )
    assert (alone.records["obstacle_seed"] == 0).all()
    assert len(np.unique(among.records["obstacle_seed"])) == 5
    among.records["obstacle_seed"][:] = 0
    np.testing.assert_array_equal(among.table, alone.table)


OWN_TASK = """
from dataclasses import dataclass

import numpy as np

from tb2rl.tasks import Commands, Outcome, Task


@dataclass(frozen=True)
class Spin(Task):
    rate: float = 1.0

    @property
    def actions(self):
        return Commands(left=(0.0, self.rate), right=(0.0, -self.rate))

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


@pytest.mark.parametrize(("simulation", "observation"), [("bullet", "discrete"), ("kinematic", "raw")])
def test_a_task_of_ones_own_is_one_class_in_a_module_of_ones_own(own_module, observation, simulation):
    settings = {"rate": 2.0, "world": "circuit", "episode_steps": 5}
    env = make_env(f"{own_module}:Spin", observation, simulation=simulation, **settings)
    assert env.action_space.n == 2
    env.reset(seed=0)
    for action in (0, 1):
        for _ in range(2):
            seen, reward, terminated, _, info = env.step(action)
        assert reward == pytest.approx(2.0, rel=0.02)
        assert (terminated, info["ended"], info["failed"]) == (False, "", False)
        assert env.observation_space.contains(seen)
    env.close()


@pytest.mark.parametrize(
    ("task", "words"),
    [
        ("mase", ["unknown task 'mase'", "did you mean 'maze'", "my-maze", "wall"]),
        ("no_such_module:Spin", ["no module 'no_such_module'"]),
        ("my_own_task:Spun", ["my_own_task", "has no 'Spun'"]),
        ("my_own_task:Outcome", ["not a class derived from tb2rl.tasks.Task"]),
        ("my_own_task:Half", ["not a class derived from tb2rl.tasks.Task with actions and outcome"]),
        ("my_own_task:Forgot", ["has the settings rate", "@dataclass(frozen=True)"]),
    ],
)
def test_an_unknown_task_is_refused(own_module, task, words):
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
    with pytest.raises(InputError, match=r'must be a name, or "module:NAME" .*, got an object of class (World|Robot)'):
        make_env(**settings)

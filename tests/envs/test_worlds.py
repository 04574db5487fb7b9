"""A task in many worlds: how settings name them, and that each episode is in a world of its own."""

from __future__ import annotations

import json
import os
import pickle

import gymnasium as gym
import numpy as np
import pytest

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.envs.worlds import absolute_worlds, find_worlds
from tb2rl.runs.config import config_from
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.simulation.random_streams import GeneratorDraws
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.registry import find_world

FEW = {"generator": "mixed", "worlds": 10}
EASY = {**FEW, "difficulty": 0.0}
NEAR = {"start_clearance": 0.25, "collision_range": 0.0}
FOREST = """
from tb2rl.worlds import World

def forest(rng, difficulty, size) -> World:
    posts = [(x, y, 0.1 + 0.1 * difficulty) for x, y in rng.uniform(1.0, size[0], (5, 2)).tolist()]
    return World.from_shapes("a forest", posts=posts, start=(0.0, 0.0, 0.0), bounds=(-1.0, -1.0, *size))

def lost(rng, difficulty, size):
    return None

def felled(rng, difficulty, size) -> World:
    return None
"""


INCLUDE = "<include><uri>model://pole</uri></include>"
POLE = (
    "<sdf version='1.6'><model name='pole'><link name='l'><collision name='c'><geometry><cylinder><radius>0.2</radius>"
    "<length>1</length></cylinder></geometry></collision></link></model></sdf>"
)


@pytest.fixture
def forest(tmp_path, monkeypatch):
    """A module of a user's own with a generator."""
    (tmp_path / "my_forest.py").write_text(FOREST)
    monkeypatch.syspath_prepend(tmp_path)


def names(setting, purpose="training"):
    return [world.name for world in find_worlds(setting, purpose)]


# ---- what a setting means


def test_worlds_are_named_alone_in_a_list_in_a_folder_or_by_a_generator(tmp_path):
    for name in ("b.txt", "a.txt"):
        (tmp_path / name).write_text("####\n#S #\n####\n")
    for name in ("notes.md", "README.txt", "readme.yaml"):
        (tmp_path / name).write_text("It is not a world.")
    assert find_worlds("loop") == (find_world("loop"),)
    assert names(["loop", "circuit"]) == ["loop", "circuit"]
    assert names(str(tmp_path)) == ["a", "b"]
    assert names({"generator": "clutter", "worlds": 2}) == ["clutter 0 (training)", "clutter 1 (training)"]
    assert names(["loop", {"generator": "maze", "worlds": 1}, str(tmp_path)]) == ["loop", "maze 0 (training)", "a", "b"]
    assert len(names("rooms")) == 512
    assert names("maze") == ["maze"], "a built-in world comes before a generator of its name"


def test_a_folder_is_found_from_any_other_one(tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.txt").write_text("####\n#S #\n####\n")
    monkeypatch.chdir(tmp_path)
    found = absolute_worlds(["mine", "mine/a.txt", "loop", FEW])
    monkeypatch.chdir("/")
    assert found[1:] == (str(tmp_path / "mine" / "a.txt"), "loop", FEW)
    assert names(found[:2]) == ["a", "a"]


def test_a_file_takes_what_it_does_not_say_from_any_folder(tmp_path, monkeypatch):
    (tmp_path / "hall.yaml").write_text(
        "boxes: [{centre: [3, 0], size: [1, 1]}]\nstart: [0, 0, 0]\nbounds: [-4, -4, 4, 4]\n"
    )
    monkeypatch.chdir(tmp_path)
    setting = absolute_worlds({"file": "hall.yaml", "start": [-1.0, 0.5, 0.1], "goal": [1.0, 0.0]})
    monkeypatch.chdir("/")
    (hall,) = find_worlds(setting)
    assert (hall.name, hall.start, hall.goal[:2]) == ("hall", (-1.0, 0.5, 0.1), (1.0, 0.0))
    config = resolve(settings={"task.world": setting})
    assert config_from(config.to_dict()).scene.world.start == hall.start
    assert make_scene(Wander(world=setting, start_clearance=0.3), "raw").worlds_for("test").world is hall


def test_a_file_finds_its_models_from_any_folder(tmp_path, monkeypatch):
    (tmp_path / "mine" / "pole").mkdir(parents=True)
    (tmp_path / "mine" / "pole" / "model.sdf").write_text(POLE)
    (tmp_path / "yard.world").write_text("<sdf version='1.6'><world name='y'>" + INCLUDE + "</world></sdf>")
    monkeypatch.chdir(tmp_path)
    said = {"file": "yard.world", "model_path": ["mine"], "start": [3, 0, 0], "bounds": [-5, -5, 5, 5]}
    config = resolve(settings={"task.world": said})
    monkeypatch.chdir("/")
    os.utime(tmp_path / "yard.world", ns=(0, 1))  # so that it is read again
    assert len(config_from(config.to_dict()).scene.world.posts) == 1


def test_a_generator_of_a_users_own(forest):
    worlds = find_worlds({"generator": "my_forest:forest", "worlds": 3, "difficulty": 1.0, "size": [9, 9]})
    assert [world.name for world in worlds] == [f"forest {i} (training)" for i in range(3)]
    assert all((world.posts[:, 2] == 0.2).all() for world in worlds)
    assert len({world.posts.tobytes() for world in worlds}) == 3
    assert worlds[0].bounds == (-1.0, -1.0, 9.0, 9.0)


def test_only_generated_worlds_depend_on_what_they_are_for():
    assert names(["loop", "maze"], "test") == names(["loop", "maze"])
    for purpose in ("training", "validation", "test"):
        assert names({"generator": "mixed", "worlds": 1}, purpose) == [f"clutter 0 ({purpose})"]
    scene = make_scene(Wander(), "raw")
    assert scene.worlds_for("test") is scene


WRONG = [
    ("rom", "unknown world 'rom'; did you mean 'rooms'?"),
    ({"generator": "clutr"}, "unknown generator 'clutr'; did you mean 'clutter'?"),
    ({"generator": "clutter", "dificulty": 0.5}, "unknown key of task.world 'dificulty'; did you mean 'difficulty'?"),
    ({"generator": "clutter", "difficulty": 1.5}, "task.world.difficulty.0: Input should be less than or equal to 1"),
    ({"generator": "clutter", "difficulty": [0.5, 0.2]}, "task.world.difficulty: must be a number, or the lowest and"),
    ({"generator": "clutter", "size": [1, 1]}, "task.world.size.0: Input should be greater than or equal to 4"),
    ({"difficulty": 0.5}, "task.world: must name its generator"),
    ([], "task.world: must name at least one world, got []"),
    ({"generator": "maze", "worlds": 100_000}, "task.world.worlds: Input should be less than or equal to 10000"),
    ([{"generator": "maze", "worlds": 6000}, {"generator": "rooms", "worlds": 4000}, "loop"], "more than 10000 worlds"),
    ([["loop"]], "task.world: must be a name, a list of names, or a generator"),
    (None, "task.world: must be a name, a list of names, or a generator"),
    ({"generator": "my_forest:lost"}, "a function that makes worlds says so"),
    ({"generator": "my_forest:felled"}, "generator my_forest:felled made no tb2rl.worlds.World but NoneType"),
    (["loop", "wall/nowhere.yaml"], "there is no world file wall/nowhere.yaml"),
    ({"file": 3}, "task.world: must name its generator, such as {generator: clutter, difficulty: 0.5}, or its file"),
    ({"file": "loop", "strat": [0, 0, 0]}, "unknown key of task.world 'strat'; did you mean 'start'?"),
    ({"file": "loop", "start": [0, 0]}, "task.world.start"),
    ({"file": "loop", "model_path": "models"}, "task.world.model_path"),
    ({"file": "rooms", "start": [1, 1, 0]}, "task.world.file must be one file, for start to count; rooms is not"),
    ({"file": "my_forest:forest", "goal": [1, 1]}, "task.world.file must be one file"),
]


@pytest.mark.parametrize(("setting", "words"), WRONG)
def test_a_setting_that_does_not_fit_is_refused_in_one_line(setting, words, forest):
    with pytest.raises(InputError) as error:
        resolve(settings={"task.world": setting})
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_so_it_is_by_every_maker():
    for make in (tb2rl.make_env, lambda world: gym.make("tb2rl:TurtleBot2Maze-v0", world=world)):
        with pytest.raises(InputError, match="unknown world 'rom'; did you mean 'rooms'"):
            make(world="rom")


def test_too_many_worlds_are_refused_before_one_is_read(tmp_path, monkeypatch):
    (tmp_path / "a.txt").write_text("S G")
    (tmp_path / "b.txt").write_text("S G")
    monkeypatch.setattr("tb2rl.envs.worlds.MOST_WORLDS", 3)
    monkeypatch.setattr("tb2rl.envs.worlds.find_world", lambda *_: pytest.fail("a world is read"))
    for setting in (["loop", "loop", str(tmp_path)], [str(tmp_path)] * 2, [{"file": "loop"}] * 4):
        with pytest.raises(InputError, match="more than 3 worlds"):
            find_worlds(setting)
    monkeypatch.setattr("tb2rl.envs.worlds.MOST_WORLDS", 1)
    with pytest.raises(InputError, match="more than 1 worlds in the folder"):
        find_worlds(str(tmp_path))


def test_an_empty_folder_holds_no_world(tmp_path):
    with pytest.raises(InputError, match=r"there is no world in the folder .*; files of worlds end in .*\.yaml"):
        find_worlds(str(tmp_path))


def test_a_start_without_room_is_refused_before_anything_drives():
    with pytest.raises(InputError, match=r"world maze 0 \(training\): the start .* lower task.start_clearance"):
        make_scene(Wander(world={"generator": "maze", "worlds": 2, "difficulty": 1.0}, start_clearance=0.9), "raw")


def test_the_command_line_takes_them_too():
    said = "task.world={generator: clutter, difficulty: [0, 0.5], worlds: 3}"
    config = resolve(settings=parse_settings([said]))
    assert config.scene.place == "clutter 0 (training), clutter 1 (training), clutter 2 (training)"
    assert config.to_dict()["task"]["world"] == {"generator": "clutter", "difficulty": [0, 0.5], "worlds": 3}
    assert resolve(settings={"task.world": FEW, "task.start_clearance": 0.3}).scene.place == "10 worlds of mixed"
    assert resolve(settings=parse_settings(["task.world=[loop, circuit]"])).scene.place == "loop, circuit"


def test_a_setting_of_a_generator_can_be_changed_alone(tmp_path):
    (tmp_path / "many.yaml").write_text("task: {world: {generator: rooms, difficulty: 0.2, worlds: 4}}\n")
    preset = str(tmp_path / "many.yaml")
    config = resolve(preset=preset, settings=parse_settings(["task.world.difficulty=0.8"]))
    assert config.task.world == {"generator": "rooms", "difficulty": 0.8, "worlds": 4}
    assert resolve(preset=preset, settings={"task.world": "loop"}).scene.place == "loop"
    for other in ({"file": "circuit", "start": [0.75, 5.0, 0.0]}, {"generator": "maze", "worlds": 3}):
        whole = resolve(preset=preset, settings={"task.world": other, "task.start_clearance": 0.3}).task.world
        assert whole == other, "no setting of the preset's generator is left"
    with pytest.raises(InputError, match=r"task\.world: must name its generator"):
        resolve(settings={"task.world.difficulty": 0.8})


# ---- where episodes begin


@pytest.mark.parametrize("begins", ["random", "fixed"])
def test_each_environment_begins_in_a_world_that_is_drawn_for_it(begins):
    task = ReachGoal(world=FEW, start=begins, start_clearance=0.3)
    spec = make_scene(task, "raw").spec
    initial_state = task.initial_state(spec, GeneratorDraws(np.random.default_rng(0), 300))
    assert np.bincount(initial_state.world.astype(int), minlength=10).min() > 10
    for i in range(300):
        world = spec.worlds[int(initial_state.world[i])]
        assert world.clearance(*initial_state.pose[i, :2]) >= 0.3 - 1e-6
        assert tuple(initial_state.goal[i]) == world.goal[:2]
        assert begins == "random" or tuple(initial_state.pose[i]) == world.start


def test_many_environments_are_in_worlds_of_their_own(start_vec_env):
    task = Wander(world=EASY, episode_steps=4)
    (env, _), (few, _) = start_vec_env(task, num_envs=300), start_vec_env(task, num_envs=30)
    first = env.loop.robot_state.initial_state.world.copy()
    assert set(first) == set(range(10))
    assert (few.loop.robot_state.initial_state.world == first[:30]).all()
    for _ in range(4):
        env.step(np.ones(300, dtype=int))
    assert (first != env.loop.robot_state.initial_state.world).mean() > 0.8


def test_episodes_change_worlds_and_start_alike_in_both_simulators(make):
    worlds = ["loop", "circuit", "round"]
    envs, seen = [make(world=worlds, simulation=simulation) for simulation in ("bullet", "kinematic")], set()
    for seed in range(8):
        poses = [env.reset(seed=seed)[1]["pose"] for env in envs]
        np.testing.assert_allclose(*poses, atol=1e-6)
        world = envs[0].scene.spec.worlds[int(envs[0].robot_state.initial_state.world[0])]
        assert world.clearance(*poses[0][:2]) >= 0.6 - 1e-3
        seen.add(world.name)
    assert seen == set(worlds)


def test_a_reset_can_name_the_world(make):
    env = make(world=EASY, simulation="kinematic")
    for world in (3, 7):
        env.reset(seed=1, options={"world": world})
        assert env.robot_state.initial_state.world == world
    where = env.scene.spec.worlds[7].start
    _, info = env.reset(seed=1, options={"world": 7, "pose": where})
    assert tuple(info["pose"]) == where
    for wrong in (10, -1, "loop"):
        with pytest.raises(InputError, match=r"options\.world"):
            env.reset(options={"world": wrong})


def test_an_evaluation_drives_in_test_worlds(straight):
    conditions = {"episodes": 6, "steps": 3, "simulation": "kinematic"}
    evaluation = tb2rl.evaluate(straight, task=Wander(world=EASY), observation="discrete", **conditions)
    assert {world.name.split()[2] for world in evaluation.scene.spec.worlds} == {"(test)"}
    assert len({episode.world for episode in evaluation.episodes}) > 2
    for episode in evaluation.episodes:
        assert evaluation.scene.spec.worlds[episode.world].clearance(*episode.start[:2]) >= 0.6 - 1e-6
        np.testing.assert_allclose(episode.path[0], episode.start[:2], atol=1e-6)


def test_a_scene_travels_to_other_processes_with_its_worlds():
    scene = make_scene(Wander(world=FEW, **NEAR), "raw")
    assert scene.observation_space == make_scene(Wander(**NEAR), "raw").observation_space
    there = pickle.loads(pickle.dumps(scene))
    starts = [s.task.initial_state(s.spec, GeneratorDraws(np.random.default_rng(0), 50)).table for s in (scene, there)]
    assert (starts[0] == starts[1]).all()


def test_a_goal_is_required_in_every_world():
    with pytest.raises(InputError, match="world loop has no goal"):
        make_scene(ReachGoal(world=["wall"] * 20 + ["loop"]), "raw")


# ---- training, validation and test worlds


@pytest.mark.slow
def test_a_policy_is_trained_and_evaluated_in_different_worlds(tmp_path):
    world, size = {"generator": "clutter", "worlds": 40, "difficulty": 0.0}, {"agent.n_steps": 8, "agent.batch_size": 8}
    training = {"total_timesteps": 64, "n_envs": 8, "simulation": "kinematic", "eval_freq": 32, "save_freq": 0}
    evaluations = {"eval_episodes": 5, "eval_steps": 5}
    settings = {"task.world": world, **size}
    policy = tb2rl.train("ppo", "maze", settings=settings, folder=tmp_path / "run", **training, **evaluations)
    evaluation = tb2rl.evaluate(policy, episodes=6, steps=3, workers=1)
    assert {w.name.split()[2] for w in evaluation.scene.spec.worlds} == {"(test)"}
    assert {w.name.split()[2] for w in policy.trained_with.scene.spec.worlds} == {"(training)"}
    tree, _ = evaluation.tree(policy.trained_with, "it")
    assert [each["world"] for each in json.loads(json.dumps(tree))["each"]] == [e.world for e in evaluation.episodes]

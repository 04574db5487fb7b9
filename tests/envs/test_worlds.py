"""A task in many worlds: how settings name them, and that each episode is in a world of its own."""

import numpy as np
import pytest

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.envs.worlds import absolute_worlds, find_worlds
from tb2rl.runs.config import config_from, parse_settings, resolve
from tb2rl.simulation.random_streams import GeneratorSource
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
"""


@pytest.fixture
def forest(tmp_path, monkeypatch):
    """A module of a user's own with a generator."""
    (tmp_path / "my_forest.py").write_text(FOREST)
    monkeypatch.syspath_prepend(tmp_path)


def names(setting, purpose="training"):
    return [world.name for world in find_worlds(setting, purpose)]


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


def test_folders_and_files_are_found_from_any_other_folder(tmp_path, monkeypatch):
    (tmp_path / "hall.yaml").write_text(
        "boxes: [{centre: [3, 0], size: [1, 1]}]\nstart: [0, 0, 0]\nbounds: [-4, -4, 4, 4]\n"
    )
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.txt").write_text("####\n#S #\n####\n")
    monkeypatch.chdir(tmp_path)
    several = absolute_worlds(["mine", "mine/a.txt", "loop", FEW])
    setting = absolute_worlds({"file": "hall.yaml", "start": [-1.0, 0.5, 0.1], "goal": [1.0, 0.0]})
    assert absolute_worlds({"file": "loop", "model_path": ["mine"]})["model_path"] == [str(tmp_path / "mine")]
    monkeypatch.chdir("/")
    assert several[1:] == (str(tmp_path / "mine" / "a.txt"), "loop", FEW)
    assert names(several[:2]) == ["a", "a"]
    (hall,) = find_worlds(setting)
    assert (hall.name, hall.start, hall.goal[:2]) == ("hall", (-1.0, 0.5, 0.1), (1.0, 0.0))
    config = resolve(settings={"task.world": setting})
    assert config_from(config.to_dict()).scene.world.start == hall.start
    assert make_scene(Wander(world=setting, start_clearance=0.3), "raw").for_purpose("test").world is hall


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
    assert scene.for_purpose("test") is scene


WRONG = [
    ("rom", "unknown world 'rom'; did you mean 'rooms'?"),
    ({"generator": "clutter", "dificulty": 0.5}, "unknown key of task.world 'dificulty'; did you mean 'difficulty'?"),
    ({"generator": "clutter", "difficulty": 1.5}, "task.world.difficulty.0: Input should be less than or equal to 1"),
    ([], "or a list of 1 to 10000 of these, got []"),
    ({"generator": "maze", "worlds": 100_000}, "task.world.worlds: Input should be less than or equal to 10000"),
    ([{"generator": "maze", "worlds": 6000}, {"generator": "rooms", "worlds": 4000}, "loop"], "more than 10000 worlds"),
    ({"generator": "my_forest:lost"}, "a function that makes worlds needs the type"),
    (["loop", "wall/nowhere.yaml"], "there is no world file wall/nowhere.yaml"),
    ({"file": "loop", "strat": [0, 0, 0]}, "unknown key of task.world 'strat'; did you mean 'start'?"),
    ({"file": "rooms", "start": [1, 1, 0]}, "task.world.file must be a single file; rooms is not"),
]


@pytest.mark.parametrize(("setting", "words"), WRONG)
def test_a_setting_that_does_not_fit_is_refused_in_one_line(setting, words, forest):
    with pytest.raises(InputError) as error:
        resolve(settings={"task.world": setting})
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_too_many_worlds_are_refused_before_one_is_read(tmp_path, monkeypatch):
    (tmp_path / "a.txt").write_text("S G")
    (tmp_path / "b.txt").write_text("S G")
    monkeypatch.setattr("tb2rl.envs.worlds.MAX_WORLDS", 3)
    monkeypatch.setattr("tb2rl.envs.worlds.find_world", lambda *_: pytest.fail("a world is read"))
    for setting in (["loop", "loop", str(tmp_path)], [{"file": "loop"}] * 4):
        with pytest.raises(InputError, match="more than 3 worlds"):
            find_worlds(setting)


def test_an_empty_folder_holds_no_world(tmp_path):
    with pytest.raises(InputError, match=r"no world in the folder .*; files of worlds end in .*\.yaml"):
        find_worlds(str(tmp_path))


def test_a_start_without_room_is_refused_before_anything_drives():
    words = r"world maze 0 \(training\): the start .* lower task.start_clearance if that is 0.9"
    with pytest.raises(InputError, match=words):
        make_scene(Wander(world={"generator": "maze", "worlds": 2, "difficulty": 1.0}, start_clearance=0.9), "raw")


def test_a_setting_of_a_generator_can_be_changed_alone(tmp_path):
    (tmp_path / "many.yaml").write_text("task: {world: {generator: rooms, difficulty: 0.2, worlds: 4}}\n")
    preset = str(tmp_path / "many.yaml")
    config = resolve(preset=preset, settings=parse_settings(["task.world.difficulty=0.8"]))
    assert config.task.world == {"generator": "rooms", "difficulty": 0.8, "worlds": 4}
    assert resolve(preset=preset, settings={"task.world": "loop"}).scene.worlds_title == "loop"
    for other in ({"file": "circuit", "start": [0.75, 5.0, 0.0]}, {"generator": "maze", "worlds": 3}):
        whole = resolve(preset=preset, settings={"task.world": other, "task.start_clearance": 0.3}).task.world
        assert whole == other, "no setting of the preset's generator is left"
    with pytest.raises(InputError, match=r"task\.world: must be a name, .* or a generator such as"):
        resolve(settings={"task.world.difficulty": 0.8})


@pytest.mark.parametrize("begins", ["random", "fixed"])
def test_each_environment_begins_in_a_world_that_is_drawn_for_it(begins):
    task = ReachGoal(world=FEW, start=begins, start_clearance=0.3)
    spec = make_scene(task, "raw").spec
    initial_state = task.initial_state(spec, GeneratorSource(np.random.default_rng(0), 300))
    assert np.bincount(initial_state.world.astype(int), minlength=10).min() > 10
    for i in range(300):
        world = spec.worlds[int(initial_state.world[i])]
        assert world.clearance(*initial_state.pose[i, :2]) >= 0.3 - 1e-6
        assert tuple(initial_state.goal[i]) == world.goal[:2]
        assert begins == "random" or tuple(initial_state.pose[i]) == world.start


@pytest.mark.bullet
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

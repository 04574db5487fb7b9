"""One robot as a Gymnasium environment: starts, steps, endings, states."""

import math

import numpy as np
import pytest

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.envs.turtlebot2_env import TurtleBot2Env
from tb2rl.simulation import InitialState
from tb2rl.simulation.spec import COLUMNS
from tb2rl.tasks.wander import Wander

FORWARD, LEFT, RIGHT = range(3)
CORNER = (-3.75, -3.75, 0.0)  # a free pose of the world "loop"
FACING_A_WALL = (*CORNER[:2], -math.pi / 2)


def test_the_same_seed_gives_the_same_episode_again_and_another_seed_another(make, drive):
    env, episodes = make(laser_noise=0.01, observation="raw"), []
    for seed in (3, 3, 4):
        first, _ = env.reset(seed=seed)
        episodes.append(np.stack([first, *(answer[0] for answer in drive(env, [LEFT, FORWARD, RIGHT] * 3))]))
    assert (episodes[0] == episodes[1]).all()
    assert (episodes[0] != episodes[2]).any()


def test_without_a_seed_every_episode_starts_elsewhere(make):
    env = make()
    assert len({tuple(env.reset(seed=0 if i == 0 else None)[1]["pose"]) for i in range(5)}) == 5


# ---- starts


def test_a_fixed_start_is_the_one_of_the_world(make):
    env = make(start="fixed")
    assert env.reset()[1]["pose"] == pytest.approx(CORNER)
    assert env.reset()[1]["pose"] == pytest.approx(CORNER)


@pytest.mark.parametrize("pose", [(3.75, 0.0, 1.5), [3.75, 0, -3], np.array([3.75, 0.0, 0.5])])
def test_an_option_says_where_to_start(pose, make):
    assert make().reset(options={"pose": pose})[1]["pose"] == pytest.approx(np.array(pose))


def test_where_an_option_says_to_start_the_noise_is_that_of_the_seed_alone_and_the_goal_stays(make):
    pose = (0.0, 0.0, 0.0)  # the start of the world "wall"
    for start in ("fixed", "random"):
        env = make("wall", "raw", laser_noise=0.01, initial_state=start)
        said, _ = env.reset(seed=1, options={"pose": pose})
        fixed, _ = make("wall", "raw", laser_noise=0.01, start="fixed").reset(seed=1)
        np.testing.assert_array_equal(said, fixed)
        assert env.robot_state.goal.tolist() == [[5.0, 0.0]]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"pose": (0, 0, 0)}, "inside a wall of world loop"),
        ({"pose": (-4.9, 0, 0)}, "inside a wall of world loop"),  # its middle is not, but its side is
        ({"pose": (100, 100, 0)}, "outside world loop"),
        ({"pose": (0, 0)}, "options.pose"),
        ({"pose": (np.nan, 0, 0)}, "finite"),
        ({"pose": "here"}, "'here'"),
        ({"initial_state": (0, 0, 0)}, "a pose is options.pose"),
        ({"initial_state": InitialState(np.zeros((2, COLUMNS)))}, "the InitialState of one robot"),
        ({"initial_state": InitialState(np.zeros((1, COLUMNS))), "world": 0}, "goes alone"),
    ],
)
def test_a_start_that_cannot_be_is_refused(options, words, make):
    with pytest.raises(InputError, match=words):
        make().reset(options=options)


# ---- steps


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_a_step_reports_where_the_robot_is_and_how_it_fares(simulation, make, drive):
    env = make("maze", "raw", start="fixed", simulation=simulation)
    _, info = env.reset()
    assert (info["distance"], info["bumped"], info["is_success"], info["failed"]) == (0, False, False, False)
    assert info["ended"] == ""
    assert info["min_range"] == pytest.approx(1.25)
    seen, reward, terminated, truncated, info = drive(env, [FORWARD] * 10)[-1]
    assert (reward, terminated, truncated) == (5, False, False)
    assert info["pose"] == pytest.approx([CORNER[0] + info["distance"], CORNER[1], 0], abs=0.01)
    assert info["distance"] == pytest.approx(1.0, abs=0.05)  # 10 steps of 0.2 s at 0.5 m/s, from rest
    assert info["min_range"] == pytest.approx(seen.min())


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_a_crash_terminates_and_has_failed(simulation, make, drive):
    env = make(simulation=simulation)
    env.reset(options={"pose": FACING_A_WALL})
    *before, (_, reward, terminated, truncated, info) = drive(env, [FORWARD] * 30)
    assert before
    assert {(answer[4]["ended"], answer[4]["failed"]) for answer in before} == {("", False)}
    assert (reward, terminated, truncated) == (-200, True, False)
    assert (info["ended"], info["failed"], info["is_success"], info["bumped"]) == ("collision", True, False, False)
    assert info["min_range"] < 0.5


def test_with_a_crash_range_of_0_only_the_bumper_ends_the_episode(make, drive):
    env = make(collision_range=0.0)
    env.reset(options={"pose": FACING_A_WALL})
    *_, info = drive(env, [FORWARD] * 30)[-1]
    assert (info["ended"], info["bumped"]) == ("collision", True)
    assert info["min_range"] == pytest.approx(0.178, abs=0.01)


def test_the_time_limit_truncates_and_is_a_success_of_wandering(make, drive):
    env = make(episode_steps=3)
    env.reset(seed=0)
    *before, (_, reward, terminated, truncated, info) = drive(env, [LEFT] * 9)
    assert [answer[4]["ended"] for answer in before] == ["", ""]
    assert (reward, terminated, truncated) == (1, False, True)
    assert (info["ended"], info["is_success"], info["failed"]) == ("time limit", True, False)


def test_reaching_the_goal_is_a_success_and_running_out_of_time_is_not(make, drive):
    env = make("wall", episode_steps=3)
    env.reset(options={"pose": (4.6, 0, 0)})
    _, reward, terminated, _, info = drive(env, [FORWARD] * 3)[-1]
    assert (reward, terminated, info["ended"], info["is_success"]) == (200, True, "goal", True)
    env.reset(options={"pose": (0, 2, 0)})
    *_, truncated, info = drive(env, [FORWARD] * 3)[-1]
    assert (truncated, info["ended"], info["is_success"], info["failed"]) == (True, "time limit", False, False)


@pytest.mark.parametrize("action", [0, np.int64(0), np.int32(0), np.array(0)])
def test_any_integer_is_an_action(action, make):
    env = make()
    env.reset(seed=0)
    assert env.step(action)[1] == 5


@pytest.mark.parametrize("action", [3, -1, 10**30, np.nan, 0.0, np.float32(1), "0", None, [0], np.array([0])])
def test_what_is_not_an_action_is_refused(action, make):
    env = make()
    env.reset(seed=0)
    with pytest.raises(InputError, match="not one of the integers 0 to 2"):
        env.step(action)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_any_velocities_are_driven(simulation, glide, make, drive):
    env = make(glide, "raw", simulation=simulation, start="fixed", episode_steps=9)
    env.reset()
    after = drive(env, [env.task.actions.nearest(np.array([0.3, 0.4]))] * 5)[-1]
    assert after[1] == pytest.approx(0.3, rel=0.02)
    assert env.robot_state.twist[0] == pytest.approx([0.3, 0.4], rel=0.02)
    with pytest.raises(InputError, match="not two numbers"):
        env.step(0)


def test_a_step_before_the_reset_is_refused(make):
    with pytest.raises(InputError, match="reset first"):
        make().step(0)


# ---- states


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize("fresh", [False, True])
def test_it_goes_on_from_a_restored_state_to_the_bit(simulation, fresh, make, drive):
    def make_one():
        return make("wall", "raw", simulation=simulation, laser_noise=0.01, episode_steps=20)

    def goes_on(env):
        answers = [env.step(action) for action in (FORWARD, LEFT, FORWARD)]
        seen, info = env.reset()
        return [answer[0] for answer in answers], [answer[4]["distance"] for answer in answers], seen, info["pose"]

    env = make_one()
    env.reset(seed=3)
    drive(env, [FORWARD, RIGHT, FORWARD])
    state = env.state()
    expected = goes_on(env)
    other = make_one() if fresh else env
    other.restore(state)
    assert other.robot_state.goal.tolist() == [[5.0, 0.0]]
    np.testing.assert_equal(goes_on(other), expected)


def test_a_state_before_the_reset_is_refused(make):
    with pytest.raises(InputError, match="reset first"):
        make().state()


# ---- making one


def test_settings_of_the_task_are_arguments(make):
    env = make("my-maze", "raw", world="circuit", beams=9, laser_noise=0.01)
    assert env.task.world == env.scene.world.name == "circuit"
    assert (env.observation_space.shape, env.action_space.n, env.scene.laser.noise) == ((9,), 4, 0.01)


def test_a_task_itself_is_an_argument_and_may_be_overridden(make):
    task = Wander(world="circuit", collision_range=0.4)
    env = make(task, "raw", collision_range=0.3, beams=9)
    assert (env.scene.world.name, env.task.collision_range, env.observation_space.shape) == ("circuit", 0.3, (9,))
    assert make(task).task == task
    other = make(task, world="round")
    assert (other.scene.world.name, other.task.collision_range) == ("round", 0.4)


def test_a_scene_is_all_that_an_environment_needs():
    scene = make_scene(Wander(world="circuit", episode_steps=2), "raw")
    env = TurtleBot2Env(scene, simulation="kinematic")
    assert (env.observation_space, env.action_space) == (scene.observation_space, scene.action_space)
    env.reset(seed=0)
    assert [env.step(0)[3] for _ in range(2)] == [False, True]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"worlt": "loop"}, ["unknown setting", "'worlt'", "did you mean 'world'"]),
        ({"world": "lop"}, ["unknown world 'lop'", "did you mean 'loop'"]),
        ({"robot": "turtelbot2"}, ["unknown robot 'turtelbot2'", "did you mean 'turtlebot2'"]),
        ({"episode_steps": 0}, ["task.episode_steps", "greater than or equal to 1"]),
        ({"laser_noise": -0.1}, ["task.laser_noise"]),
        ({"control_period": np.nan}, ["task.control_period", "finite"]),
        ({"turn_rate": "fast"}, ["task.turn_rate", "'fast'"]),
        ({"start": "anywhere"}, ["task.start", "'fixed' or 'random'"]),
        ({"beam_indices": [-1]}, ["task.beam_indices.0"]),
        ({"beam_indices": []}, ["task.beam_indices", "at least 1"]),
        ({"range_bins": [2.0, 1.0]}, ["task.range_bins", "strictly increase"]),
        ({"observation": "pixels"}, ["unknown observation 'pixels'"]),
    ],
)
@pytest.mark.parametrize("task", ["maze", Wander()], ids=["name", "Task"])
def test_a_setting_that_does_not_fit_is_refused_by_name(task, settings, words):
    with pytest.raises(InputError) as error:
        make_env(task, **settings)
    for word in words:
        assert word in str(error.value)


def test_what_only_pybullet_has_is_refused(make):
    with pytest.raises(InputError, match="window"):
        make("maze", render_mode="human", simulation="kinematic")
    with pytest.raises(InputError, match="camera"):
        make("maze", simulation="kinematic").camera()
    with pytest.raises(InputError, match="bullet, kinematic"):
        make("maze", simulation="kinematik")

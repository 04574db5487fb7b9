"""One environment for Gymnasium: initial states, steps, endings, settings."""

import math

import numpy as np
import pytest

from tb2rl import make_env
from tb2rl.core.errors import InputError
from tb2rl.simulation import InitialState
from tb2rl.tasks.wander import Wander

FORWARD, LEFT, RIGHT = range(3)
CORNER = (-3.75, -3.75, 0.0)  # a free pose of the world "loop"
FACING_A_WALL = (*CORNER[:2], -math.pi / 2)


def test_a_seed_gives_the_same_episode_again_and_no_seed_something_else(make, drive):
    env, episodes = make("maze", "raw", simulation="kinematic", laser_noise=0.01), []
    for seed in (3, 3, 4, None, None):
        first, _ = env.reset(seed=seed)
        episodes.append(np.stack([first, *(answer[0] for answer in drive(env, [LEFT, FORWARD, RIGHT]))]))
    np.testing.assert_array_equal(episodes[0], episodes[1])
    assert len({episode.tobytes() for episode in episodes}) == 4


def test_an_option_sets_the_pose_while_noise_and_goal_stay(make):
    pose = (0.0, 0.0, 0.0)  # the start of the world "wall"
    for start in ("fixed", "random"):
        env = make("wall", "raw", simulation="kinematic", laser_noise=0.01, start=start)
        said, _ = env.reset(seed=1, options={"pose": pose})
        fixed, _ = make("wall", "raw", simulation="kinematic", laser_noise=0.01, start="fixed").reset(seed=1)
        np.testing.assert_array_equal(said, fixed)
        assert env.robot_state.goal.tolist() == [[5.0, 0.0]]
        assert env.reset(options={"pose": np.array([1.0, 0.0, 0.5])})[1]["pose"].tolist() == [1.0, 0.0, 0.5]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"pose": (0, 0, 0)}, "touches a wall or is outside of world loop"),
        ({"pose": (-4.9, 0, 0)}, "touches a wall or is outside of world loop"),  # its middle is not, but its side is
        ({"pose": (100, 100, 0)}, "outside of world loop"),
        ({"pose": (np.nan, 0, 0)}, "options.pose"),
        ({"initial_state": (0, 0, 0)}, "alone; or use options.pose"),
    ],
)
def test_an_option_that_does_not_fit_is_refused(options, words, make):
    with pytest.raises(InputError, match=words):
        make(simulation="kinematic").reset(options=options)


def test_the_option_initial_state_goes_alone_and_has_one_row(make):
    env = make(simulation="kinematic")
    for rows, more in ((2, {}), (1, {"world": 0})):
        initial_state = InitialState.default(env.scene.spec, rows)
        with pytest.raises(InputError, match=r"options.initial_state must be one row of InitialState"):
            env.reset(options={"initial_state": initial_state, **more})
    initial_state = InitialState.default(env.scene.spec, 1)
    initial_state.pose[:] = 3.75, 0.0, 1.5
    assert env.reset(options={"initial_state": initial_state})[1]["pose"] == pytest.approx([3.75, 0.0, 1.5])


@pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])
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


@pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])
def test_a_collision_terminates_and_has_failed(simulation, make, drive):
    env = make(simulation=simulation)
    env.reset(options={"pose": FACING_A_WALL})
    *before, (_, reward, terminated, truncated, info) = drive(env, [FORWARD] * 30)
    assert before
    assert {(answer[4]["ended"], answer[4]["failed"]) for answer in before} == {("", False)}
    assert (reward, terminated, truncated) == (-200, True, False)
    assert (info["ended"], info["failed"], info["is_success"], info["bumped"]) == ("collision", True, False, False)
    assert info["min_range"] < 0.5


def test_reaching_the_goal_is_a_success_and_running_out_of_time_is_not(make, drive):
    env = make("wall", episode_steps=3)
    env.reset(options={"pose": (4.6, 0, 0)})
    _, reward, terminated, _, info = drive(env, [FORWARD] * 3)[-1]
    assert (reward, terminated, info["ended"], info["is_success"]) == (200, True, "goal", True)
    env.reset(options={"pose": (0, 2, 0)})
    *_, truncated, info = drive(env, [FORWARD] * 3)[-1]
    assert (truncated, info["ended"], info["is_success"], info["failed"]) == (True, "time limit", False, False)


@pytest.mark.parametrize("simulation", ["bullet", "mujoco", "kinematic"])
def test_any_velocities_are_driven(simulation, glide, make, drive):
    env = make(glide, "raw", simulation=simulation, start="fixed", episode_steps=9)
    env.reset()
    after = drive(env, [env.task.actions.nearest(np.array([0.3, 0.4]))] * 5)[-1]
    assert after[1] == pytest.approx(0.3, rel=0.02)
    assert env.robot_state.twist[0] == pytest.approx([0.3, 0.4], rel=0.02)
    with pytest.raises(InputError, match="not two numbers"):
        env.step(0)


def test_a_task_itself_is_an_argument_and_may_be_overridden(make):
    task = Wander(world="circuit", collision_range=0.4)
    env = make(task, "raw", simulation="kinematic", collision_range=0.3, beams=9)
    assert (env.scene.world.name, env.task.collision_range, env.observation_space.shape) == ("circuit", 0.3, (9,))
    other = make(task, simulation="kinematic", world="round")
    assert (other.scene.world.name, other.task.collision_range) == ("round", 0.4)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"worlt": "loop"}, ["unknown setting", "'worlt'", "did you mean 'world'"]),
        ({"episode_steps": 0}, ["task.episode_steps", "greater than or equal to 1"]),
        ({"control_period": np.nan}, ["task.control_period", "finite"]),
        ({"start": "anywhere"}, ["task.start", "'fixed' or 'random'"]),
        ({"range_bins": [2.0, 1.0]}, ["task.range_bins", "strictly increase"]),
    ],
)
def test_a_setting_that_does_not_fit_is_refused_by_name(settings, words):
    for task in ("maze", Wander()):
        with pytest.raises(InputError) as error:
            make_env(task, **settings)
        for word in words:
            assert word in str(error.value)


def test_unknown_modes_and_simulators_and_colours_without_them_are_refused(make):
    with pytest.raises(InputError, match="unknown render_mode 'ansi'; known: human, rgb_array"):
        make(render_mode="ansi")
    env = make("maze", simulation="kinematic")
    env.reset()
    with pytest.raises(InputError, match="cameras see no colours"):
        env.camera()
    with pytest.raises(InputError, match="bullet, kinematic"):
        make("maze", simulation="kinematik")

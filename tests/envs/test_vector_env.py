"""Many environments by `gymnasium.make_vec`: infos, modes of autoreset, arguments."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from tb2rl.core.errors import InputError
from tb2rl.envs.vector_env import TurtleBot2VectorEnv
from tb2rl.tasks.wander import Wander

MAZE = "tb2rl:TurtleBot2Maze-v0"


@pytest.fixture
def make_vec():
    """`gymnasium.make_vec` in the kinematic simulator, whose environments are closed after the test."""
    made = []

    def make(**settings):
        made.append(gym.make_vec(MAZE, **{"simulation": "kinematic", **settings}))
        return made[-1]

    yield make
    for env in made:
        env.close()


def turning(observations):
    """Actions by a rule of the observations."""
    return (np.asarray(observations)[:, 0] * 100).astype(int) % 3


def test_the_kinematic_simulator_runs_many_environments_at_once(make_vec):
    batch = make_vec(num_envs=5, observation="raw", beams=9, world="circuit")
    assert isinstance(batch, TurtleBot2VectorEnv)
    assert batch.loop.scene.world.name == "circuit"
    assert (batch.single_observation_space.shape, batch.observation_space.shape) == ((9,), (5, 9))


@pytest.mark.bullet
def test_pybullet_runs_each_environment_alone(make_vec):
    physics = make_vec(num_envs=2, simulation=None)
    assert isinstance(physics, SyncVectorEnv)
    assert {type(env.simulator).__name__ for env in physics.envs} == {"BulletSimulator"}


@pytest.mark.parametrize(
    ("mode", "simulation"),
    [(None, "bullet"), ("vector_entry_point", "kinematic"), ("sync", "bullet"), ("async", "kinematic")],
)
def test_every_mode_of_gymnasium_drives(mode, simulation, make_vec):
    env = make_vec(num_envs=2, vectorization_mode=mode, simulation=simulation, max_episode_steps=8)
    seen, infos = env.reset(seed=2)
    for _ in range(8):
        assert infos["ended"].tolist() == ["", ""]
        assert env.observation_space.contains(seen)
        seen, rewards, _, truncated, infos = env.step(np.array([1, 2]))
    assert (rewards.tolist(), truncated.all()) == ([1.0, 1.0], True)
    same_step = env.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    assert same_step == (mode not in ("sync", "async"))
    last = infos["final_info"] if same_step else infos
    assert last["ended"].tolist() == ["time limit", "time limit"]


def episodes_of(env, steps):
    """The episodes of each environment by one rule for all: their observations, and how they ended."""
    mode, num_envs = env.metadata["autoreset_mode"], env.num_envs
    seen, _ = env.reset(seed=4)
    episodes, over = [[[row.tolist()]] for row in seen], np.zeros(num_envs, bool)
    for _ in range(steps):
        seen, _, terminated, truncated, infos = env.step(turning(seen))
        ended = terminated | truncated
        same_step = mode == AutoresetMode.SAME_STEP and ended.any()
        last, final = (infos["final_obs"], infos["final_info"]) if same_step else (seen, infos)
        if mode == AutoresetMode.DISABLED and ended.any():
            seen, _ = env.reset(options={"reset_mask": ended})
        for i in range(num_envs):
            if over[i] and mode == AutoresetMode.NEXT_STEP:
                episodes[i].append([seen[i].tolist()])
            elif ended[i]:
                episodes[i][-1] += [last[i].tolist(), final["ended"][i]]
                if mode != AutoresetMode.NEXT_STEP:
                    episodes[i].append([seen[i].tolist()])
            else:
                episodes[i][-1].append(seen[i].tolist())
        over = ended
    return episodes


def test_episodes_are_the_same_in_every_mode_of_autoreset(make_vec):
    settings = {"num_envs": 10, "observation": "raw", "episode_steps": 30}
    found = [episodes_of(make_vec(autoreset_mode=mode, **settings), 100) for mode in AutoresetMode]
    for same in zip(*found, strict=True):
        complete = min(len(episodes) for episodes in same) - 1
        assert complete >= 2
        assert same[0][:complete] == same[1][:complete] == same[2][:complete]
    endings = {episode[-1] for episodes in found[0] for episode in episodes[:-1]}
    assert endings == {"collision", "time limit"}


@pytest.mark.parametrize("mode", AutoresetMode)
def test_every_mode_answers_in_the_form_of_gymnasiums_own(mode, make_vec):
    settings = {"num_envs": 4, "observation": "raw", "episode_steps": 5}
    ours = make_vec(autoreset_mode=mode, **settings)
    theirs = make_vec(vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **settings)

    def form(value):
        if isinstance(value, dict):
            return {key: form(part) for key, part in sorted(value.items())}
        return value.dtype, value.shape

    answers = [env.reset(seed=1) for env in (ours, theirs)]
    for _ in range(18):
        assert [form(part) for part in answers[0]] == [form(part) for part in answers[1]]
        ended = answers[0][3] if len(answers[0]) == 5 else np.zeros(4, bool)
        if mode == AutoresetMode.DISABLED and ended.any():
            answers = [env.reset(options={"reset_mask": ended.copy()}) for env in (ours, theirs)]
            continue
        answers = [env.step(np.ones(4, int)) for env in (ours, theirs)]
        np.testing.assert_array_equal(answers[0][2:4], answers[1][2:4])  # a turning robot meets the time limit alone


def test_all_values_are_those_of_the_environments_for_stable_baselines3(make_vec, start_vec_env):
    env, expected = start_vec_env(Wander(episode_steps=30, laser_noise=0.01), num_envs=8, seed=3)
    vector_env = make_vec(num_envs=8, observation="raw", episode_steps=30, laser_noise=0.01)
    observations, _ = vector_env.reset(seed=3)
    for _ in range(70):
        np.testing.assert_array_equal(observations, expected)
        actions = turning(observations)
        expected, rewards, dones, infos = env.step(actions)
        observations, same_rewards, terminated, truncated, found = vector_env.step(actions)
        np.testing.assert_array_equal((same_rewards, terminated | truncated), (rewards, dones))
        for i in dones.nonzero()[0]:
            np.testing.assert_array_equal(found["final_obs"][i], infos[i]["terminal_observation"])
            for name in ("pose", "distance", "ended", "failed", "is_success"):
                np.testing.assert_array_equal(found["final_info"][name][i], infos[i][name])


def test_a_disabled_autoreset_waits_for_the_caller(make_vec):
    env = make_vec(num_envs=3, episode_steps=2, autoreset_mode="Disabled")
    with pytest.raises(InputError, match="needs a reset first"):
        env.reset(options={"reset_mask": np.ones(3, bool)})
    env.reset(seed=0)
    env.step(np.ones(3, int))
    observations, *_, infos = env.step(np.ones(3, int))
    with pytest.raises(InputError, match="the episode of environment 0 is over"):
        env.step(np.ones(3, int))
    returned = observations, infos["bumped"], infos["min_range"], infos["pose"]
    before = [part.copy() for part in returned]
    _, infos = env.reset(options={"reset_mask": np.array([True, False, True])})
    assert (infos["ended"].tolist(), infos["_ended"].tolist()) == (["", None, ""], [True, False, True])
    np.testing.assert_equal(list(returned), before)
    with pytest.raises(InputError, match="the episode of environment 1 is over"):
        env.step(np.ones(3, int))
    env.reset(options={"reset_mask": np.array([False, True, False])})
    env.step(np.ones(3, int))


@pytest.mark.parametrize(
    "actions", [np.zeros(3, int), np.zeros((4, 1), int), np.full(4, 3), np.full(4, -1), np.zeros(4), "abcd"]
)
def test_actions_outside_the_action_space_are_refused(actions, make_vec):
    env = make_vec(num_envs=4)
    env.reset(seed=0)
    with pytest.raises(InputError, match=r"the actions .* are not in MultiDiscrete"):
        env.step(actions)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda make: make(render_mode="rgb_array"), "make one environment with gymnasium.make"),
        (lambda make: make().reset(options={"pose": (0, 0, 0)}), "unknown option 'pose'"),
        (lambda make: make(num_envs=0), "num_envs.* greater than or equal to 1"),
        (lambda make: make().step(np.array([0])), "needs a reset first"),
        (lambda make: make().reset(options={"reset_mask": [True]}), "reset_mask must be a bool"),
        (lambda make: make(autoreset_mode="next"), "unknown autoreset_mode 'next'.* NEXT_STEP"),
        (lambda make: make(wordl="loop"), "did you mean 'world'"),
    ],
)
def test_what_many_environments_do_not_have_is_refused(call, words, make_vec):
    with pytest.raises(InputError, match=words):
        call(make_vec)


def test_velocities_outside_their_space_are_clipped():
    env = gym.make_vec("tb2rl:TurtleBot2Drive-v0", num_envs=2, simulation="kinematic", start="fixed")
    env.reset(seed=0)
    for action in (1.0, 9.0):
        env.step(np.full((2, 2), action))
    assert env.loop.robot_state.command.tolist() == [[0.65, 2.0]] * 2

"""Many environments by `gymnasium.make_vec`: infos, modes of autoreset, arguments."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from tb2rl.core.errors import InputError
from tb2rl.envs.scene import make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.envs.vector_env import TurtleBot2VectorEnv
from tb2rl.simulation.bullet.simulator import BulletSimulator
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


def test_the_simulator_decides_how_many_environments_run(make_vec):
    batch = make_vec(num_envs=5, observation="raw", beams=9, world="circuit")
    assert isinstance(batch, TurtleBot2VectorEnv)
    assert batch.loop.scene.world.name == "circuit"
    assert (batch.single_observation_space.shape, batch.observation_space.shape) == ((9,), (5, 9))
    physics = make_vec(num_envs=2, simulation=None)
    assert isinstance(physics, SyncVectorEnv)
    assert all(isinstance(env.simulator, BulletSimulator) for env in physics.envs)


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
        seen, rewards, terminated, truncated, infos = env.step(np.array([1, 2]))
        assert rewards.tolist() == [1.0, 1.0]
    assert (terminated.any(), truncated.all()) == (False, True)
    same_step = env.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    assert same_step == (mode not in ("sync", "async"))
    last = infos["final_info"] if same_step else infos
    assert last["ended"].tolist() == ["time limit", "time limit"]


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize(("mode", "found"), [("NextStep", "NEXT_STEP"), (AutoresetMode.DISABLED, "DISABLED")])
def test_the_mode_of_autoreset_is_an_argument(mode, found, simulation, make_vec):
    env = make_vec(num_envs=1, simulation=simulation, autoreset_mode=mode)
    assert env.metadata["autoreset_mode"] is AutoresetMode[found]


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


def test_a_disabled_autoreset_waits_for_the_caller(make_vec):
    env = make_vec(num_envs=3, episode_steps=2, autoreset_mode="Disabled")
    with pytest.raises(InputError, match="reset_mask needs a reset of all environments first"):
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


def test_episodes_are_those_of_the_env_for_stable_baselines3():
    scene = make_scene(Wander(laser_noise=0.01, episode_steps=60), "raw")
    ours, theirs = TurtleBot2VectorEnv(scene, 30), TurtleBot2VecEnv(scene, 30)
    theirs.seed(4)
    (observations, _), seen, finished = ours.reset(seed=4), theirs.reset(), 0
    for _ in range(100):
        actions = turning(seen)
        observations, rewards, terminated, truncated, infos = ours.step(actions)
        seen, expected, dones, reports = theirs.step(actions)
        np.testing.assert_array_equal(observations, seen)
        np.testing.assert_array_equal(rewards, expected)
        np.testing.assert_array_equal(terminated | truncated, dones)
        np.testing.assert_array_equal(infos.get("_final_obs", np.zeros(30, bool)), dones)
        for i in np.flatnonzero(dones):
            finished += 1
            np.testing.assert_array_equal(infos["final_obs"][i], reports[i]["terminal_observation"])
            for key in ("pose", "ended", "failed", "is_success", "distance", "min_range", "bumped"):
                np.testing.assert_array_equal(infos["final_info"][key][i], reports[i][key])
            assert {*infos["final_info"]["ended"][~dones]} <= {None}
            assert truncated[i] == reports[i]["TimeLimit.truncated"]
            assert (infos["distance"][i], infos["ended"][i]) == (0.0, "")  # the next one has begun
    assert finished > 30


def test_a_seed_gives_the_same_again_and_no_seed_something_else(make_vec):
    env = make_vec(num_envs=4)
    poses = [env.reset(seed=seed)[1]["pose"] for seed in (3, 3, [1, 2, 3, 4], None, None)]
    np.testing.assert_array_equal(poses[0], poses[1])
    assert len({pose.tobytes() for pose in poses}) == 4


@pytest.mark.parametrize(
    "actions", [np.zeros(3, int), np.zeros((4, 1), int), np.full(4, 3), np.full(4, -1), np.zeros(4), "abcd"]
)
def test_actions_outside_the_action_space_are_refused(actions, make_vec):
    env = make_vec(num_envs=4)
    env.reset(seed=0)
    with pytest.raises(InputError, match=r"the actions .* are not of MultiDiscrete"):
        env.step(actions)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda make: make(render_mode="rgb_array"), "make one with gymnasium.make"),
        (lambda make: make().reset(options={"pose": (0, 0, 0)}), "there is no option 'pose'"),
        (lambda make: make(num_envs=0), "num_envs.* greater than or equal to 1"),
        (lambda make: make().step(np.array([0])), "step needs a reset first"),
        (lambda make: make().reset(options={"reset_mask": [True]}), "reset_mask must be a bool"),
        (lambda make: make(autoreset_mode="next"), "unknown autoreset_mode 'next'.* NEXT_STEP"),
        (lambda make: make(simulation="gazebo"), "unknown simulator 'gazebo'"),
        (lambda make: make(wordl="loop"), "did you mean 'world'"),
    ],
)
def test_what_many_environments_do_not_have_is_refused(call, words, make_vec):
    with pytest.raises(InputError, match=words):
        call(make_vec)


def test_any_velocities_are_driven(glide):
    env = TurtleBot2VectorEnv(make_scene(glide(), "raw"), 6)
    env.reset(seed=0)
    *_, infos = env.step(np.tile(np.float32([1.0, -1.0]), (6, 1)))
    assert (infos["distance"] > 0).all()
    with pytest.raises(InputError, match="are not of Box"):
        env.step(np.zeros(6))

"""Many environments by `gymnasium.make_vec`: the twin's batch, or PyBullet's, with Gymnasium's own `infos`."""

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
    """`gymnasium.make_vec`, whose environments are closed after the test."""
    made = []

    def make(*arguments, **settings):
        made.append(gym.make_vec(MAZE, *arguments, **settings))
        return made[-1]

    yield make
    for env in made:
        env.close()


def test_the_simulation_decides_as_it_does_for_one_environment(make_vec):
    twin = make_vec(num_envs=5, simulation="kinematic", observation="raw", beams=9, world="circuit")
    assert isinstance(twin, TurtleBot2VectorEnv)
    assert twin.loop.scene.world.name == "circuit"
    assert (twin.single_observation_space.shape, twin.observation_space.shape) == ((9,), (5, 9))
    physics = make_vec(num_envs=2)
    assert isinstance(physics, SyncVectorEnv)
    assert all(isinstance(env.simulator, BulletSimulator) for env in physics.envs)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize("mode", [None, "vector_entry_point", "sync", "async"])
def test_every_mode_of_gymnasium_drives(mode, simulation, make_vec):
    env = make_vec(num_envs=2, vectorization_mode=mode, simulation=simulation, max_episode_steps=8)
    seen, infos = env.reset(seed=2)
    assert env.observation_space.contains(seen)
    for _ in range(7):
        assert infos["ended"].tolist() == ["", ""]
        seen, rewards, terminated, truncated, infos = env.step(np.array([1, 2]))
        assert rewards.tolist() == [1.0, 1.0]
    seen, rewards, terminated, truncated, infos = env.step(np.array([1, 2]))
    assert (terminated.any(), truncated.all()) == (False, True)
    same_step = env.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    assert same_step == (mode not in ("sync", "async"))
    last = infos["final_info"] if same_step else infos
    assert last["ended"].tolist() == ["time limit", "time limit"]


def rollout(env, steps):
    """What the first robot of each kind of environment is told, by one rule for all."""
    seen, _ = env.reset(seed=4)
    told = []
    for _ in range(steps):
        answer = env.step((np.asarray(seen)[:, 0] * 100).astype(int) % 3)
        seen = answer[0]
        told.append(answer)
    return told


def test_infos_have_the_form_of_gymnasiums_own(make_vec):
    settings = {"simulation": "kinematic", "observation": "raw", "episode_steps": 30}
    ours = make_vec(num_envs=20, **settings)
    same_step = {"autoreset_mode": AutoresetMode.SAME_STEP}
    theirs = make_vec(num_envs=20, vectorization_mode="sync", vector_kwargs=same_step, **settings)

    def form(infos):
        return {k: form(v) if isinstance(v, dict) else (v.dtype, v.shape) for k, v in sorted(infos.items())}

    assert form(ours.reset(seed=0)[1]) == form(theirs.reset(seed=0)[1])
    forms = [{str(form(infos)) for *_, infos in rollout(env, 60)} for env in (ours, theirs)]
    assert forms[0] == forms[1]
    assert len(forms[0]) == 2  # with and without a final step


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize(
    ("mode", "found"),
    [(None, "SAME_STEP"), ("NEXT_STEP", "NEXT_STEP"), ("NextStep", "NEXT_STEP"), (AutoresetMode.DISABLED, "DISABLED")],
)
def test_the_mode_of_autoreset_is_an_argument(mode, found, simulation, make_vec):
    env = make_vec(num_envs=1, simulation=simulation, **({} if mode is None else {"autoreset_mode": mode}))
    assert env.metadata["autoreset_mode"] is AutoresetMode[found]


def episodes_of(env, steps):
    """What each robot meets, by one rule for all, in its episodes: an entry for each observation."""
    mode, num_envs = env.metadata["autoreset_mode"], env.num_envs
    seen, infos = env.reset(seed=4)
    episodes = [[[(infos["pose"][i].tolist(), seen[i].tolist(), 0.0, "")]] for i in range(num_envs)]
    over = np.zeros(num_envs, bool)
    for _ in range(steps):
        actions = (seen[:, 0] * 100).astype(int) % 3
        if mode == AutoresetMode.NEXT_STEP:
            actions[over] = 2  # is ignored
        seen, rewards, terminated, truncated, infos = env.step(actions)
        ended = terminated | truncated
        last = infos["final_info"] if ended.any() and mode == AutoresetMode.SAME_STEP else infos
        for i in range(num_envs):
            if over[i]:
                assert (rewards[i], ended[i], infos["ended"][i], infos["distance"][i]) == (0.0, False, "", 0.0)
                episodes[i].append([(infos["pose"][i].tolist(), seen[i].tolist(), 0.0, "")])
            elif ended[i]:
                at = infos["final_obs"][i] if last is not infos else seen[i]
                assert last["ended"][i]
                episodes[i][-1].append((last["pose"][i].tolist(), at.tolist(), float(rewards[i]), last["ended"][i]))
            else:
                episodes[i][-1].append((infos["pose"][i].tolist(), seen[i].tolist(), float(rewards[i]), ""))
        if mode == AutoresetMode.SAME_STEP:
            for i in np.flatnonzero(ended):
                episodes[i].append([(infos["pose"][i].tolist(), seen[i].tolist(), 0.0, "")])
        elif mode == AutoresetMode.NEXT_STEP:
            over = ended
        elif ended.any():
            before = seen.copy()
            seen, infos = env.reset(options={"reset_mask": ended})
            np.testing.assert_array_equal(seen[~ended], before[~ended])
            np.testing.assert_array_equal(infos["_pose"], ended)
            for i in np.flatnonzero(ended):
                episodes[i].append([(infos["pose"][i].tolist(), seen[i].tolist(), 0.0, "")])
    return episodes


def test_robots_meet_the_same_whenever_their_episodes_begin(make_vec):
    settings = {"num_envs": 20, "simulation": "kinematic", "observation": "raw", "episode_steps": 30}
    modes = [make_vec(autoreset_mode=mode, **settings) for mode in AutoresetMode]
    found = [episodes_of(env, 100) for env in modes]
    for same in zip(*found, strict=True):
        shortest = min(len(episodes) for episodes in same)
        assert shortest >= 3
        complete = [episodes[: shortest - 1] for episodes in same]
        assert complete[0] == complete[1] == complete[2]
    endings = {episode[-1][-1] for episodes in found[0] for episode in episodes[:-1]}
    assert endings == {"collision", "time limit"}


@pytest.mark.parametrize("mode", AutoresetMode)
def test_every_mode_answers_in_the_form_of_gymnasiums_own(mode, make_vec):
    settings = {"num_envs": 4, "simulation": "kinematic", "observation": "raw", "episode_steps": 5}
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
        np.testing.assert_array_equal(answers[0][2:4], answers[1][2:4])  # who turns meets the time limit alone


def test_a_disabled_autoreset_waits_for_the_caller(make_vec):
    env = make_vec(num_envs=3, simulation="kinematic", episode_steps=2, autoreset_mode="Disabled")
    with pytest.raises(InputError, match="reset_mask needs a reset of all robots first"):
        env.reset(options={"reset_mask": np.ones(3, bool)})
    env.reset(seed=0)
    env.step(np.ones(3, int))
    kept = env.step(np.ones(3, int))
    with pytest.raises(InputError, match="the episode of robot 0 is over"):
        env.step(np.ones(3, int))
    handed_out = [part.copy() for part in (kept[0], kept[-1]["bumped"], kept[-1]["min_range"], kept[-1]["pose"])]
    _, infos = env.reset(options={"reset_mask": np.array([True, False, True])})
    assert (infos["ended"].tolist(), infos["_ended"].tolist()) == (["", None, ""], [True, False, True])
    after = (kept[0], kept[-1]["bumped"], kept[-1]["min_range"], kept[-1]["pose"])
    for before, now in zip(handed_out, after, strict=True):
        np.testing.assert_array_equal(before, now)
    with pytest.raises(InputError, match="the episode of robot 1 is over"):
        env.step(np.ones(3, int))
    env.reset(options={"reset_mask": np.array([False, True, False])})
    env.step(np.ones(3, int))


def test_it_is_the_batch_that_stable_baselines_gets():
    scene = make_scene(Wander(laser_noise=0.01, episode_steps=60), "raw")
    ours, theirs = TurtleBot2VectorEnv(scene, 30), TurtleBot2VecEnv(scene, 30)
    theirs.seed(4)
    seen, finished = theirs.reset(), 0
    for observations, rewards, terminated, truncated, infos in rollout(ours, 150):
        seen, expected, dones, reports = theirs.step((seen[:, 0] * 100).astype(int) % 3)
        np.testing.assert_array_equal(observations, seen)
        np.testing.assert_array_equal(rewards, expected)
        np.testing.assert_array_equal(terminated | truncated, dones)
        np.testing.assert_array_equal(infos.get("_final_obs", np.zeros(30, bool)), dones)
        for robot in np.flatnonzero(dones):
            finished += 1
            report = reports[robot]
            np.testing.assert_array_equal(infos["final_obs"][robot], report["terminal_observation"])
            for key in ("ended", "failed", "is_success", "distance", "min_range", "bumped"):
                assert infos["final_info"][key][robot] == report[key]
            np.testing.assert_array_equal(infos["final_info"]["pose"][robot], report["pose"])
            running = np.flatnonzero(~dones)
            assert {*infos["final_info"]["ended"][running]} <= {None}
            assert truncated[robot] == report["TimeLimit.truncated"]
            assert (infos["distance"][robot], infos["ended"][robot]) == (0.0, "")  # the next one has begun
    assert finished > 60


def test_a_seed_gives_the_same_again_and_no_seed_something_else(make_vec):
    env = make_vec(num_envs=4, simulation="kinematic")
    poses = [env.reset(seed=seed)[1]["pose"] for seed in (3, 3, [1, 2, 3, 4], None, None)]
    np.testing.assert_array_equal(poses[0], poses[1])
    assert len({pose.tobytes() for pose in poses}) == 4


@pytest.mark.parametrize(
    "actions", [np.zeros(3, int), np.zeros((4, 1), int), np.full(4, 3), np.full(4, -1), np.zeros(4), "abcd"]
)
def test_actions_that_are_none_are_refused(actions, make_vec):
    env = make_vec(num_envs=4, simulation="kinematic")
    env.reset(seed=0)
    with pytest.raises(InputError, match=r"the actions .* are not of MultiDiscrete"):
        env.step(actions)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda make: make(simulation="kinematic", render_mode="rgb_array"), "make one with gymnasium.make"),
        (lambda make: make(simulation="kinematic").reset(options={"pose": (0, 0, 0)}), "there is no option 'pose'"),
        (lambda make: make(simulation="kinematic", num_envs=0), "num_envs.* greater than or equal to 1"),
        (lambda make: make(simulation="kinematic").step(np.array([0])), "step needs a reset first"),
        (lambda make: make(simulation="kinematic").reset(options={"reset_mask": [True]}), "reset_mask must be a bool"),
        (lambda make: make(autoreset_mode="next"), "unknown autoreset_mode 'next'.* NEXT_STEP"),
        (lambda make: make(simulation="gazebo"), "unknown simulation 'gazebo'"),
        (lambda make: make(simulation="kinematic", wordl="loop"), "did you mean 'world'"),
    ],
)
def test_what_a_batch_does_not_have_is_refused(call, words, make_vec):
    with pytest.raises(InputError, match=words):
        call(make_vec)


def test_any_velocities_are_driven(glide):
    env = TurtleBot2VectorEnv(make_scene(glide(), "raw"), 6)
    env.reset(seed=0)
    *_, infos = env.step(np.tile(np.float32([1.0, -1.0]), (6, 1)))
    assert (infos["distance"] > 0).all()
    with pytest.raises(InputError, match="are not of Box"):
        env.step(np.zeros(6))

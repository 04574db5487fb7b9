"""TorchRL: its checker, rollouts, frame skip, and pictures beside the laser."""

import pytest
import torch as th

pytest.importorskip("torchrl", reason="torchrl is not installed")
envs = pytest.importorskip("torchrl.envs")
utils = pytest.importorskip("torchrl.envs.utils")


@pytest.mark.parametrize(
    ("env_id", "simulation"), [("tb2rl:TurtleBot2Maze-v0", "kinematic"), ("tb2rl:TurtleBot2MazeRaw-v0", "bullet")]
)
def test_the_checker_finds_nothing_and_a_rollout_is_seeded(env_id, simulation):
    env = envs.GymEnv(env_id, simulation=simulation)
    utils.check_env_specs(env)
    rollouts = []
    for _ in range(2):
        th.manual_seed(0)
        env.set_seed(3)
        rollouts.append(env.rollout(20, break_when_any_done=False))
    env.close()
    assert rollouts[0].batch_size == (20,)
    assert rollouts[0]["observation"].shape == (20, *env.observation_spec["observation"].shape)
    assert rollouts[0]["next", "reward"].isfinite().all()
    for key in ("observation", "action", ("next", "reward")):
        assert th.equal(rollouts[0][key], rollouts[1][key])


def test_frame_skip_repeats_the_action():
    """TorchRL tries the argument `frameskip` first, and expects a TypeError."""
    env, plain = (envs.GymEnv("tb2rl:TurtleBot2Maze-v0", simulation="kinematic", frame_skip=skip) for skip in (3, 1))
    rewards = []
    for one, steps in ((env, 2), (plain, 6)):
        one.set_seed(1)
        forward = one.rollout(steps, policy=lambda observation: th.tensor([1, 0, 0]))
        rewards.append(forward["next", "reward"].sum())
        one.close()
    assert rewards[0] == rewards[1] > 0


def test_pictures_are_observations_beside_the_laser():
    env = envs.GymEnv("tb2rl:TurtleBot2MazeRaw-v0", simulation="kinematic", from_pixels=True, pixels_only=False)
    utils.check_env_specs(env)
    rollout = env.rollout(3)
    env.close()
    assert rollout["pixels"].dtype == th.uint8
    assert rollout["pixels"].shape[-1] == 3
    assert rollout["observation"].shape == (3, 36)
    assert not th.equal(rollout["pixels"][0], rollout["next", "pixels"][2])

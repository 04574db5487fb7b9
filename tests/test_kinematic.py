"""The fast twin does what the robot in PyBullet does, and thousands of robots do what one does."""

from __future__ import annotations

import math

import gymnasium as gym
import numba
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_sb3

import tb2rl
from tb2rl.evaluation import Evaluator
from tb2rl.laser import cast
from tb2rl.maze import load_maze, maze_from, maze_names
from tb2rl.observations import prepare
from tb2rl.robot import BASE_RADIUS, MAX_SPEED, MAX_TURN_RATE, WHEEL_SEPARATION, Laser
from tb2rl.runs import config_of
from tb2rl.simulation import PHYSICS_RATE
from tb2rl.simulation.bullet import BulletSimulation
from tb2rl.simulation.kinematic import WHEEL_ACCELERATION, WHEEL_COUPLING, KinematicSimulation
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander
from tb2rl.vec_env import BatchVecEnv

OPEN = {"bounds": [-40, -40, 40, 40], "start": [0, 0, 0], "boxes": [{"centre": [45, 45], "size": [1, 1]}]}
PERIOD = 0.2  # [s]


def rims(twist: np.ndarray) -> np.ndarray:
    v, w = twist.T
    return np.stack([v - w * WHEEL_SEPARATION / 2, v + w * WHEEL_SEPARATION / 2], axis=1)


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        ((0.6, 0.0), (WHEEL_ACCELERATION + WHEEL_COUPLING, WHEEL_ACCELERATION + WHEEL_COUPLING)),
        ((0.0, 3.0), (-WHEEL_ACCELERATION + WHEEL_COUPLING, WHEEL_ACCELERATION - WHEEL_COUPLING)),
        ((0.3, 0.3 / (WHEEL_SEPARATION / 2)), (0.0, WHEEL_ACCELERATION)),
    ],
)
def test_the_acceleration_is_that_of_the_robot_in_pybullet(told, expected):
    simulation = BulletSimulation(maze_from(OPEN, "open"), Laser(1))
    simulation.reset(np.zeros((1, 3)), np.random.default_rng(0))
    steps = [simulation.step(np.array([told]), 1 / PHYSICS_RATE).twist for _ in range(6)]
    speeds = rims(np.concatenate(steps))
    np.testing.assert_allclose((speeds[5] - speeds[0]) / 5 * PHYSICS_RATE, expected, atol=0.03)


@pytest.mark.parametrize("name", maze_names())
def test_random_commands_end_where_they_do_in_pybullet(name):
    """200 sequences of 5 s in each maze, a new command over the whole range of the robot at each control step."""
    maze, rng, count = load_maze(name), np.random.default_rng(1), 200
    poses = maze.random_poses(rng, count, 0.6)
    commands = rng.uniform((-MAX_SPEED, -2.0), (MAX_SPEED, 2.0), (25, count, 2))
    twin = KinematicSimulation(maze, Laser(2), count)
    twin.reset(poses, rng)
    clear = np.ones(count, dtype=bool)
    for told in commands:
        reading = twin.step(told, PERIOD)
        clear &= [maze.clearance(x, y) > BASE_RADIUS + 0.05 for x, y, _ in reading.pose]
    physics = BulletSimulation(maze, Laser(2))
    ends = []
    for i in np.flatnonzero(clear):
        physics.reset(poses[i : i + 1], rng)
        for told in commands[:, i : i + 1]:
            end = physics.step(told, PERIOD)
        ends.append(end.pose[0])
    missed = np.array(ends) - reading.pose[clear]
    distance, turn = np.hypot(*missed.T[:2]), np.abs(np.remainder(missed[:, 2] + math.pi, math.tau) - math.pi)
    assert len(ends) > 150
    assert np.median(distance) < 0.01
    assert np.percentile(distance, 99) < 0.05
    assert math.degrees(np.median(turn)) < 1.0
    assert math.degrees(np.percentile(turn, 99)) < 5.0


@pytest.mark.parametrize("name", maze_names())
def test_nobody_gets_into_a_wall(name):
    maze, rng, count = load_maze(name), np.random.default_rng(2), 300
    twin = KinematicSimulation(maze, Laser(2), count)
    twin.reset(maze.random_poses(rng, count, BASE_RADIUS + 0.01), rng)
    touched = np.zeros(count, dtype=bool)
    told = rng.uniform((-MAX_SPEED, -MAX_TURN_RATE), (MAX_SPEED, MAX_TURN_RATE), (count, 2))
    for step in range(100):
        if step % 5 == 0:
            told = rng.uniform((-MAX_SPEED, -1.0), (MAX_SPEED, 1.0), (count, 2))
        reading = twin.step(told, PERIOD)
        touched |= reading.bumped
        assert min(maze.clearance(x, y) for x, y, _ in reading.pose) > BASE_RADIUS - 1e-3
    assert touched.any()


@pytest.mark.parametrize("yaw", [0.0, 0.4, -0.9])
def test_a_robot_stops_at_a_wall_and_gets_away_backwards(yaw):
    maze = maze_from({**OPEN, "boxes": [{"centre": [1.5, 0], "size": [1, 20]}]}, "one wall")
    twin = KinematicSimulation(maze, Laser(3))
    twin.reset(np.array([[0.0, 0.0, yaw]]), np.random.default_rng(0))
    for _ in range(20):
        reading = twin.step(np.array([[MAX_SPEED, 0.0]]), PERIOD)
    assert reading.bumped[0]
    assert maze.clearance(*reading.pose[0, :2]) == pytest.approx(BASE_RADIUS, abs=1e-3)
    for _ in range(5):
        reading = twin.step(np.array([[-MAX_SPEED, 0.0]]), PERIOD)
    assert not reading.bumped[0]
    assert maze.clearance(*reading.pose[0, :2]) > BASE_RADIUS + 0.1


def crash_free_in_the_twin(policy, poses: np.ndarray, steps: int) -> float:
    config = config_of(policy)
    maze, task, observe, laser = prepare(config.task_settings, config.observation)
    twin, crashed = KinematicSimulation(maze, laser, len(poses)), np.zeros(len(poses), dtype=bool)
    reading = twin.reset(poses, np.random.default_rng(0))
    for _ in range(steps):
        actions, _ = policy.predict(observe(reading), deterministic=True)
        before, reading = reading, twin.step(task.commands[actions], task.control_period)
        crashed |= task.judge(before, actions, reading).endings["crash"]
    return 1.0 - float(crashed.mean())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["zoo:maze-loop-qlearn", "zoo:maze-loop-dqn"])
def test_a_policy_is_as_good_in_both_simulations(name):
    """200 episodes of 1 500 control steps from the same start poses."""
    policy = tb2rl.load(name)
    with Evaluator(config_of(policy).task_settings, config_of(policy).observation, episodes=200) as evaluator:
        in_physics = evaluator.run(policy.policy).summary()["crash_free_rate"]
    assert crash_free_in_the_twin(policy, evaluator.poses, evaluator.steps) == pytest.approx(in_physics, abs=0.02)


def test_both_simulations_read_the_same_at_the_same_pose():
    maze, laser, rng = load_maze("round"), Laser(36), np.random.default_rng(3)
    poses = maze.random_poses(rng, 20, 0.3)
    physics, twin = BulletSimulation(maze, laser), KinematicSimulation(maze, laser, 20)
    read = twin.reset(poses, rng).ranges
    for pose, ranges in zip(poses, read, strict=True):
        np.testing.assert_allclose(physics.reset(pose[None], rng).ranges[0], ranges, atol=1e-3)
    exact = np.empty_like(read)
    cast(poses, np.cos(laser.angles), np.sin(laser.angles), maze.boxes, maze.posts, exact)
    np.testing.assert_array_equal(read, exact)


def test_noise_has_its_width_and_robots_have_their_own():
    twin = KinematicSimulation(load_maze("loop"), Laser(200, noise=0.05), 50)
    pose = np.tile(twin.maze.start, (50, 1))
    noisy = twin.reset(pose, np.random.default_rng(0)).ranges
    exact = KinematicSimulation(twin.maze, Laser(200), 1).reset(pose[:1], np.random.default_rng(0)).ranges
    errors = noisy - exact
    assert errors.std() == pytest.approx(0.05, rel=0.03)
    assert abs(errors.mean()) < 0.002
    assert len(np.unique(errors[:, 0])) == 50
    again = twin.step(np.zeros((50, 2)), PERIOD).ranges
    assert abs(np.corrcoef(errors.ravel(), (again - exact).ravel())[0, 1]) < 0.05


def test_a_restored_state_goes_on_to_the_bit():
    maze, rng = load_maze("maze"), np.random.default_rng(4)
    twin = KinematicSimulation(maze, Laser(9, noise=0.01), 30)
    twin.reset(maze.random_poses(rng, 30, 0.3), rng)
    told = rng.uniform(-1, 1, (20, 30, 2))
    for command in told:
        twin.step(command, PERIOD)
    state = twin.state()
    first = [twin.step(command, PERIOD) for command in told]
    twin.restore(state)
    for command, reading in zip(told, first, strict=True):
        again = twin.step(command, PERIOD)
        np.testing.assert_array_equal(again.pose, reading.pose)
        np.testing.assert_array_equal(again.ranges, reading.ranges)


# ---- as environments


def rollout(robots: int, threads: int, task=None, steps: int = 300) -> list[np.ndarray]:
    """What the first eight of so many robots meet, each told by a rule of its own observation."""
    numba.set_num_threads(threads)
    env = BatchVecEnv(task or Wander(noise=0.01, episode_steps=60), "raw", robots)
    env.seed(5)
    observations, seen = env.reset(), []
    for _ in range(steps):
        observations, rewards, dones, _ = env.step((observations[:, 0] * 100).astype(int) % 3)
        seen += [observations[:8].copy(), rewards[:8].copy(), dones[:8].copy()]
    return seen


def test_results_do_not_depend_on_threads():
    for one, two in zip(rollout(1000, 1), rollout(1000, numba.config.NUMBA_NUM_THREADS), strict=True):
        np.testing.assert_array_equal(one, two)


def test_an_episode_ends_as_stable_baselines_expects():
    env = BatchVecEnv(Wander(episode_steps=40), "discrete", 64, reward_scale=0.5)
    env.seed(0)
    env.reset()
    rng, endings, returns = np.random.default_rng(0), set(), np.zeros(64)
    for _ in range(100):
        observations, rewards, dones, infos = env.step(rng.choice(3, size=64, p=[0.2, 0.5, 0.3]))
        returns += rewards / 0.5
        for i, info in enumerate(infos):
            assert bool(info) == dones[i]
            if dones[i]:
                endings.add(info["ended"])
                assert info["TimeLimit.truncated"] == (info["ended"] == "time limit") == info["is_success"]
                assert info["episode"]["r"] == pytest.approx(returns[i])
                assert env.observation_space.contains(info["terminal_observation"])
                assert env.observation_space.contains(observations[i])
                returns[i] = 0.0
    assert endings == {"crash", "time limit"}


def test_a_batch_of_one_is_the_gymnasium_environment():
    task = Wander(start="fixed", episode_steps=80)
    batch, env = BatchVecEnv(task, "raw", 1), tb2rl.make_env(task, "raw", simulation="kinematic")
    np.testing.assert_array_equal(batch.reset()[0], env.reset()[0])
    for action in np.random.default_rng(1).choice(3, size=80, p=[0.3, 0.4, 0.3]):
        observations, rewards, dones, infos = batch.step(np.array([action]))
        observation, reward, terminated, truncated, info = env.step(action)
        assert (rewards[0], dones[0]) == (reward, terminated or truncated)
        if dones[0]:
            assert infos[0]["ended"] == info["ended"]
            assert infos[0]["distance"] == pytest.approx(info["distance"])
            break
        np.testing.assert_array_equal(observations[0], observation)


def test_a_goal_is_reached_in_the_twin_too():
    env = BatchVecEnv(ReachGoal(maze="wall", goal=(1.0, 0.0), start="fixed"), "raw", 3)
    env.reset()
    for _ in range(20):
        _, _, dones, infos = env.step(np.zeros(3, dtype=int))
        if dones.any():
            break
    assert [info["ended"] for info in infos] == ["goal"] * 3
    assert all(info["is_success"] for info in infos)


@pytest.mark.parametrize("observation", ["discrete", "raw"])
@pytest.mark.parametrize("name", tb2rl.GYM_IDS)
def test_one_robot_is_a_plain_gymnasium_environment(name, observation):
    env = gym.make(f"tb2rl:{name}", observation=observation, simulation="kinematic")
    check_env(env.unwrapped, skip_render_check=True)
    check_sb3(env.unwrapped)


def test_what_only_pybullet_has_is_refused():
    with pytest.raises(tb2rl.InputError, match="window"):
        tb2rl.make_env("maze", render_mode="human", simulation="kinematic")
    with pytest.raises(tb2rl.InputError, match="camera"):
        tb2rl.make_env("maze", simulation="kinematic").camera()
    with pytest.raises(tb2rl.InputError, match="bullet, kinematic"):
        tb2rl.make_env("maze", simulation="kinematik")

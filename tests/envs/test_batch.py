"""Many robots as one vectorised environment: what each meets, and how episodes end and begin."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import tb2rl
from tb2rl.envs.encodings import rows
from tb2rl.envs.make import make_task
from tb2rl.envs.scene import make_scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.evaluation.evaluator import Evaluator
from tb2rl.robots.robot import MAX_SPEED
from tb2rl.runs.loading import config_of
from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.tasks.reach_goal import ReachGoal
from tb2rl.tasks.wander import Wander


def batch(task, observation, num_envs, seed=0, **arguments):
    env = TurtleBot2VecEnv(make_scene(task, observation), num_envs, **arguments)
    env.seed(seed)
    return env, env.reset()


def rollout(num_envs, steps=300):
    """What the first eight of so many robots meet, each told by a rule of its own observation."""
    env, observations = batch(Wander(laser_noise=0.01, episode_steps=60), "raw", num_envs, seed=5)
    seen = []
    for _ in range(steps):
        observations, rewards, dones, _ = env.step((observations[:, 0] * 100).astype(int) % 3)
        seen += [observations[:8].copy(), rewards[:8].copy(), dones[:8].copy()]
    return seen


def test_results_do_not_depend_on_threads(monkeypatch):
    monkeypatch.setattr("tb2rl.simulation.kinematic.simulator.WORTH_THREADS", 0.0)
    monkeypatch.setattr("tb2rl.simulation.threads.THREADS", 1)
    alone = rollout(1000)
    monkeypatch.setattr("tb2rl.simulation.threads.THREADS", 3)
    for one, two in zip(alone, rollout(1000), strict=True):
        np.testing.assert_array_equal(one, two)


def test_equal_seeds_give_equal_episodes_and_others_do_not():
    poses = [batch(Wander(), "raw", 20, seed)[0].loop.simulator.state()["poses"] for seed in (1, 1, 2)]
    np.testing.assert_array_equal(poses[0], poses[1])
    assert (poses[0] != poses[2]).all()


def test_the_way_to_go_is_each_robots_own_where_episodes_end():
    task = make_task("navigate", {"world": {"generator": "clutter", "worlds": 2}, "episode_steps": 60})
    (env, _), ended = batch(task, "raw", 20), []
    for _ in range(59):
        *_, dones, _ = env.step(np.tile((1.0, 0.0), (20, 1)))
        robot_state = env.loop.robot_state
        if dones.any():
            ended.append(dones.sum())
            np.testing.assert_array_equal(vars(robot_state)["path_length"], replace(robot_state).path_length)
    assert len(ended) > 5
    assert max(ended) < 20


def test_an_episode_ends_as_stable_baselines_expects():
    env, _ = batch(Wander(episode_steps=40), "discrete", 64, reward_scale=0.5)
    rng, endings, returns = np.random.default_rng(0), set(), np.zeros(64)
    for _ in range(100):
        observations, rewards, dones, infos = env.step(rng.choice(3, size=64, p=[0.2, 0.5, 0.3]))
        returns += rewards / 0.5
        for i, info in enumerate(infos):
            assert bool(info) == dones[i]
            if dones[i]:
                endings.add(info["ended"])
                assert info["TimeLimit.truncated"] == (info["ended"] == "time limit") == info["is_success"]
                assert info["failed"] == (info["ended"] == "collision")
                assert info["episode"]["r"] == pytest.approx(returns[i])
                assert env.observation_space.contains(info["terminal_observation"])
                assert env.observation_space.contains(observations[i])
                returns[i] = 0.0
    assert endings == {"collision", "time limit"}


def test_an_episode_lasts_as_many_steps_as_it_says():
    env, _ = batch(Wander(episode_steps=7), "raw", 5)
    ends = [env.step(np.ones(5, int))[2:] for _ in range(15)]
    assert [dones.all() for dones, _ in ends] == [step in (6, 13) for step in range(15)]
    assert [info["episode"]["l"] for info in ends[13][1]] == [7] * 5


CAMERA = ["laser", {"camera": {"width": 12, "height": 9}}]


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
@pytest.mark.parametrize(
    ("observation", "settings"),
    [("raw", {}), ("discrete", {"frame_stack": 3}), ("raw", {"observe": CAMERA, "frame_stack": 2})],
)
def test_each_robot_is_a_gymnasium_environment(observation, settings, simulation, make):
    task = Wander(start="fixed", episode_steps=50, **settings)
    many, first = batch(task, observation, 2, simulation=simulation)
    envs, ends = [make(task, observation, simulation=simulation) for _ in range(2)], set()
    np.testing.assert_equal([rows(first, robot) for robot in range(2)], [env.reset()[0] for env in envs])
    for actions in np.random.default_rng(1).choice(3, size=(150, 2), p=[0.3, 0.4, 0.3]):
        observations, rewards, dones, infos = many.step(actions)
        for robot, (env, action) in enumerate(zip(envs, actions, strict=True)):
            seen, reward, terminated, truncated, info = env.step(action)
            assert (rewards[robot], dones[robot]) == (reward, terminated or truncated)
            if dones[robot]:
                ends.add(info["ended"])
                assert infos[robot]["TimeLimit.truncated"] == truncated
                assert infos[robot]["distance"] == pytest.approx(info.pop("distance"))
                np.testing.assert_equal(infos[robot]["terminal_observation"], seen)
                np.testing.assert_equal({name: infos[robot][name] for name in info}, info)
                seen, _ = env.reset()
            np.testing.assert_equal(rows(observations, robot), seen)
    many.close()
    assert ends == {"collision", "time limit"}


def test_a_batch_of_one_drives_at_any_velocities_as_the_gymnasium_environment(glide):
    task = glide(start="fixed", episode_steps=30)
    many, _ = batch(task, "raw", 1)
    env = tb2rl.make_env(task, "raw", simulation="kinematic")
    env.reset()
    for action in np.random.default_rng(1).uniform(-1.2, 1.2, (29, 2)).astype(np.float32):
        observations, rewards, dones, _ = many.step(action[None])
        seen, reward, terminated, truncated, _ = env.step(action)
        assert rewards[0] == pytest.approx(reward)
        assert dones[0] == (terminated or truncated)
        if dones[0]:
            break
        np.testing.assert_array_equal(observations[0], seen)


def test_a_goal_is_reached_in_the_twin_too():
    env, _ = batch(ReachGoal(world="wall", goal=(1.0, 0.0), start="fixed"), "raw", 3)
    for _ in range(20):
        _, _, dones, infos = env.step(np.zeros(3, dtype=int))
        if dones.any():
            break
    assert [info["ended"] for info in infos] == ["goal"] * 3
    assert all(info["is_success"] and not info["failed"] for info in infos)


# ---- images


def test_images_are_observed_by_all_robots_and_kept_where_episodes_end(image_task):
    env, first = batch(image_task(episode_steps=20), "raw", 50)
    space, rng, ended = env.observation_space, np.random.default_rng(0), 0

    def of(observations, robot):
        return {n: v[robot] for n, v in observations.items()} if isinstance(observations, dict) else observations[robot]

    def image(observation):
        return observation["map"] if isinstance(observation, dict) else observation

    assert all(space.contains(of(first, robot)) for robot in range(50))
    for _ in range(45):
        observations, _, dones, infos = env.step(rng.choice(3, size=50))
        for robot in range(50):
            seen, pose = of(observations, robot), env.loop.simulator.state()["poses"][robot]
            assert space.contains(seen)
            row, column = (pose[:2] % 9.0 * 4.0).astype(int)
            assert image(seen)[0, row, column] == image(seen).sum() > 0  # it is the picture of where the robot is
            if dones[robot]:
                ended += 1
                last = infos[robot]["terminal_observation"]
                row, column = (infos[robot]["pose"][:2] % 9.0 * 4.0).astype(int)
                assert space.contains(last)
                assert image(last)[0, row, column] == image(last).sum() > 0
    assert ended >= 100


# ---- episodes in other worlds, with other robots


@dataclass(frozen=True)
class Varied(Wander):
    """Each episode begins in one of the worlds with a robot of another top speed."""

    def initial_state(self, spec, draws):
        numbers = draws.uniform(2)
        start = InitialState.default(spec, draws.num_envs, (numbers[:, 0] * len(spec.worlds)).astype(int))
        start.parameters[:, MAX_SPEED] *= 0.5 + 0.5 * numbers[:, 1]
        return start


def test_each_episode_begins_with_a_world_and_a_robot_of_its_own(make_setup):
    worlds = make_setup("loop", "maze", "wall", beams=36)
    scene = replace(make_scene(Varied(episode_steps=5), "raw"), spec=worlds)
    env = TurtleBot2VecEnv(scene, 40)
    env.seed(0)
    env.reset()
    starts = []
    for _ in range(11):
        env.step(np.zeros(40, int))
        starts.append(InitialState(env.state()["simulator"]["initial_state"]))
    first, last, anew = starts[0], starts[3], starts[4]  # the fifth step ends all episodes
    assert set(first.world) == {0, 1, 2}
    np.testing.assert_array_equal(first.table, last.table)
    assert (last.parameters[:, MAX_SPEED] != anew.parameters[:, MAX_SPEED]).all()
    assert (last.world != anew.world).any()
    few = TurtleBot2VecEnv(scene, 10)
    few.seed(0)
    few.reset()
    for _ in range(11):
        few.step(np.zeros(10, int))
    np.testing.assert_array_equal(few.state()["simulator"]["initial_state"], starts[-1].table[:10])


# ---- states


def test_it_goes_on_from_a_restored_state_to_the_bit():
    task, rng = ReachGoal(laser_noise=0.01, episode_steps=15), np.random.default_rng(0)
    actions = rng.integers(3, size=(60, 25))
    env, _ = batch(task, "raw", 25)
    for chosen in actions[:20]:
        env.step(chosen)
    state = env.state()
    expected = [env.step(chosen) for chosen in actions[20:]]
    for other in (env, TurtleBot2VecEnv(env.loop.scene, 25)):
        other.restore(state)
        for chosen, answer in zip(actions[20:], expected, strict=True):
            np.testing.assert_equal(other.step(chosen), answer)


# ---- what policies do there


def failure_free_in_the_twin(policy, poses, steps):
    scene = config_of(policy).scene
    twin, failed = KinematicSimulator(scene.spec, len(poses)), np.zeros(len(poses), dtype=bool)
    start = InitialState.default(scene.spec, len(poses))
    start.pose[:] = poses
    robot_state = twin.reset(start, np.random.default_rng(0))
    for _ in range(steps):
        actions, _ = policy.predict(scene.encoding(robot_state), deterministic=True)
        before, robot_state = robot_state, twin.step(scene.actions.commands(actions), scene.task.control_period)
        failed |= scene.task.outcome(before, actions, robot_state).failed["collision"]
    return 1.0 - float(failed.mean())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["zoo:maze-loop-qlearn", "zoo:maze-loop-dqn"])
def test_a_policy_is_as_good_in_both_simulations(name):
    """100 episodes of 1 500 control steps from the same start poses."""
    policy = tb2rl.load(name)
    with Evaluator(config_of(policy).scene, episodes=100) as evaluator:
        in_physics = evaluator.run(policy.policy).summary()["failure_free_rate"]
    poses = np.concatenate([start.pose for start in evaluator.starts])
    in_twin = failure_free_in_the_twin(policy, poses, evaluator.scene.task.episode_steps)
    assert in_twin == pytest.approx(in_physics, abs=0.02)

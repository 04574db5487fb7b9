"""Fair evaluations: start poses of their own, where the task says, and the same result on any machine."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from stable_baselines3 import A2C

from tb2rl import evaluate, make_env
from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import agent_names
from tb2rl.envs.scene import make_scene
from tb2rl.evaluation.evaluator import EPISODES, SEED, STEPS, TRAINING_SEED, Evaluator
from tb2rl.execution.local import LocalExecutor
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.runs.algorithm import Spaces, make_algorithm, make_baseline
from tb2rl.runs.layers import resolve
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.registry import find_world

GUIDED = {"dwa", "pursuit", "vfh"}  # only drive to a goal: tests/agents/test_guided.py
BASELINES = [name for name in agent_names() if find_agent(name).algorithm is None and name not in GUIDED]


# ---- on any machine


@pytest.mark.parametrize("name", BASELINES)
def test_the_result_does_not_depend_on_the_number_of_processes(name, outcomes):
    config = resolve(name, settings={"task.laser_noise": 0.01})
    alone, shared = (
        evaluate(make_baseline(config), config, episodes=5, steps=40, workers=workers) for workers in (1, 2)
    )
    assert outcomes(alone) == outcomes(shared)
    assert alone.summary() == shared.summary()


def test_jobs_elsewhere_drive_the_same_episodes_in_their_order():
    config = resolve("random", settings={"task.laser_noise": 0.01})
    policy = make_baseline(config)
    with Evaluator(config.scene, 5, 40, workers=1) as evaluator:
        here, there = list(evaluator.drive(policy)), list(evaluator.drive(policy, 1, LocalExecutor(2)))
    assert [episode.episode_return for episode in there] == [episode.episode_return for episode in here[1:]]


def test_a_memory_is_kept_in_every_process(outcomes):
    settings = {"task.observation": "raw", "train.n_envs": 1, "agent.policy_kwargs.lstm_hidden_size": 8}
    config = resolve("sb3_contrib:RecurrentPPO", settings=settings)
    policy = make_algorithm(config, Spaces.vectorised(config))
    th.nn.init.normal_(policy.policy.action_net.weight)  # else it does the same everywhere
    alone, shared = (evaluate(policy, config, episodes=3, steps=40, workers=workers) for workers in (1, 2))
    assert outcomes(alone) == outcomes(shared)


def test_the_same_evaluation_twice_gives_the_same_result(run, outcomes):
    twice = [evaluate(run, episodes=3, steps=30, workers=1) for _ in range(2)]
    assert outcomes(twice[0]) == outcomes(twice[1])


def test_a_part_of_an_evaluation_is_its_first_episodes(outcomes):
    config = resolve("pursuit", "navigate", settings={"task.world": "mixed", "task.guide": "plan"})
    whole, part = (evaluate(make_baseline(config), config, episodes=5, steps=20, workers=1, only=n) for n in (None, 2))
    assert outcomes(part) == outcomes(whole)[:2]


def test_an_evaluator_serves_several_policies(outcomes):
    config = resolve("wallfollower")
    with Evaluator(config.scene, episodes=2, steps=10, workers=2) as evaluator:
        first, again = (evaluator.run(make_baseline(config)) for _ in range(2))
    assert outcomes(first) == outcomes(again)


@pytest.mark.parametrize("changed", [{"urdf": Path("missing.urdf")}, {"wheel_joints": ("wheel_left", "wheel_rite")}])
def test_a_robot_that_cannot_be_loaded_is_refused_before_processes_start(changed):
    scene = resolve("wallfollower").scene
    unusable = replace(scene, spec=replace(scene.spec, robot=replace(ROBOT, **changed)))
    with pytest.raises(InputError, match=r"robot turtlebot2: .*(cannot load missing\.urdf|no joint 'wheel_rite')"):
        Evaluator(unusable, episodes=2, steps=3, workers=2)


# ---- where episodes begin, and when they end


def test_every_episode_has_a_start_of_its_own_and_the_time_limit_that_was_asked_for():
    config = resolve("wallfollower", settings={"task.start": "fixed", "task.episode_steps": 7})
    evaluation = evaluate(make_baseline(config), config, episodes=4, steps=20, workers=1)
    assert (evaluation.steps, evaluation.task.episode_steps) == (20, 20)
    assert len({episode.start for episode in evaluation.episodes}) == 4
    assert [episode.length for episode in evaluation.episodes] == [20] * 4
    for episode in evaluation.episodes:
        assert len(episode.path) == 21
        assert episode.path[0] == pytest.approx(episode.start[:2], abs=1e-6)
        assert np.linalg.norm(np.diff(episode.path, axis=0), axis=1).sum() == pytest.approx(episode.distance, rel=1e-3)


def test_the_standard_evaluation_is_the_one_that_the_readme_tells_of():
    assert (EPISODES, STEPS) == (100, 1500)


def test_training_does_not_draw_the_standard_start_poses():
    env, training = make_env("maze"), set()
    for seed in range(20):
        training |= {tuple(env.reset(seed=seed if first else None)[1]["pose"].round(6)) for first in (True, False)}
    env.close()

    def poses(seed: int) -> set[tuple]:
        rng = np.random.default_rng(seed)
        return {tuple(pose.round(6)) for pose in find_world("loop").random_poses(rng, 100, Wander().start_clearance)}

    assert len(training) == 40
    assert training & poses(0), "an evaluation of seed 0 would start where a training of seed 0 does"
    assert training.isdisjoint(poses(SEED))
    assert poses(TRAINING_SEED).isdisjoint(poses(SEED))


def test_the_standard_start_poses_are_those_of_the_world_for_its_seed():
    evaluator = Evaluator(resolve().scene, workers=1)
    clearance = Wander().start_clearance
    expected = find_world("loop").random_poses(np.random.default_rng(SEED), EPISODES, clearance)
    np.testing.assert_array_equal([start.pose[0] for start in evaluator.starts], expected)


def test_an_episode_leads_to_the_goal_that_was_drawn_with_its_start():
    config = resolve("pursuit", "navigate", settings={"task.world": {"generator": "clutter", "worlds": 2}})
    with Evaluator(config.scene, episodes=12, steps=1, workers=1) as evaluator:
        episodes = evaluator.run(make_baseline(config)).episodes
    assert [each.goal for each in episodes] == [tuple(start.goal[0].tolist()) for start in evaluator.starts]
    assert len({(each.world, each.goal) for each in episodes}) > 4
    ways = [
        config.scene.spec.goal_paths.path_length(*np.stack([s.world, s.way]).astype(int), s.pose)
        for s in evaluator.starts
    ]
    assert min(ways) > config.task.goal_radius, "of two random goals it is the farther one"


def test_a_task_that_leads_to_the_goals_of_its_worlds_is_judged_by_them():
    settings = {"task.world": ["wall", {"generator": "clutter", "worlds": 2}], "task.start": "fixed"}
    config = resolve("pursuit", "navigate", settings=settings)
    with Evaluator(config.scene, episodes=12, steps=1, workers=1) as evaluator:
        episodes = evaluator.run(make_baseline(config)).episodes
    worlds = config.scene.spec.worlds
    assert [each.goal for each in episodes] == [worlds[each.world].goal[:2] for each in episodes]
    assert len({each.world for each in episodes}) == 3
    assert len({each.start for each in episodes}) == 12


def test_imperfect_robots_are_judged_from_the_same_starts(ahead):
    starts = []
    for variation in ("none", "strong"):
        with Evaluator(make_scene(Wander(variation=variation), "raw"), episodes=4, steps=2, workers=1) as evaluator:
            starts.append([episode.start for episode in evaluator.run(ahead).episodes])
    assert starts[0] == starts[1]
    assert len(set(starts[0])) == 4


def test_a_task_says_itself_where_its_episodes_begin(northward, ahead):
    episodes = evaluate(ahead, resolve("random", northward), episodes=4, steps=3, workers=1).episodes
    assert [episode.start[2] for episode in episodes] == [math.pi / 2] * 4
    assert len({episode.start[:2] for episode in episodes}) == 4
    for episode in episodes:
        ways = np.diff(episode.path, axis=0)
        assert (np.abs(ways[:, 0]) < 0.01).all()
        assert (ways[1:, 1] > 0.02).all(), "it drives along y"


# ---- what drives


def test_random_actions_crash():
    config = resolve("random")
    assert evaluate(make_baseline(config), config, episodes=30, workers=1).summary()["failure_free_rate"] < 0.05


def test_the_wall_follower_does_not():
    config = resolve("wallfollower")
    evaluation = evaluate(make_baseline(config), config, episodes=6, steps=300, workers=1)
    assert evaluation.summary()["failure_free_rate"] == 1.0
    assert evaluation.summary()["mean_speed"] > 0.2, "nor does it stand still"


@pytest.mark.slow
def test_the_wall_follower_is_a_baseline_to_beat_in_the_standard_evaluation():
    config = resolve("wallfollower")
    assert evaluate(make_baseline(config), config).summary()["failure_free_rate"] > 0.9


def test_anything_that_predicts_can_be_evaluated(ahead):
    episodes = evaluate(ahead, resolve(), episodes=3, steps=200, workers=1).episodes
    assert [(episode.ended, episode.failed) for episode in episodes] == [("collision", True)] * 3
    assert [episode.episode_return for episode in episodes] == [5.0 * (e.length - 1) - 200.0 for e in episodes]
    assert [episode.actions.tolist() for episode in episodes] == [[0] * e.length for e in episodes]
    assert {episode.actions.dtype for episode in episodes} == {np.dtype(np.uint8)}


def test_continuous_actions_are_evaluated_and_kept_as_they_were(cruise):
    config = resolve("random", cruise)
    evaluation = evaluate(make_baseline(config), config, episodes=3, steps=40, workers=1)
    for episode in evaluation.episodes:
        assert (episode.actions.shape, episode.actions.dtype) == ((episode.length, 2), np.float32)
        assert np.abs(episode.actions).max() <= 1.0
        assert len(np.unique(episode.actions, axis=0)) == episode.length
        assert 0.0 < episode.distance <= 0.5 * 0.2 * episode.length
    assert len({tuple(episode.actions[0].tolist()) for episode in evaluation.episodes}) == 3


def test_observations_may_be_mappings(pictured, ahead):
    config = resolve("random", pictured, settings={"task.observation": "raw"})
    evaluation = evaluate(ahead, config, episodes=1, steps=5, workers=1)
    assert len(ahead.observations) == evaluation.episodes[0].length
    for observation in ahead.observations:
        assert {name: (values.shape, values.dtype) for name, values in observation.items()} == {
            "picture": ((1, 36, 36), np.uint8),
            "numbers": ((36,), np.float32),
        }
    policy = make_baseline(config)
    assert evaluate(policy, config, episodes=2, steps=5, workers=1).summary()["episodes"] == 2


def test_a_policy_of_unknown_origin_needs_a_task():
    with pytest.raises(InputError, match=r"object does not come from .*: name its task, such as task='maze'"):
        evaluate(object())


def test_settings_change_the_task(run):
    evaluation = evaluate(run, settings={"world": "circuit", "laser_noise": 0.1}, episodes=1, steps=2, workers=1)
    assert (evaluation.task.world, evaluation.scene.world.name, evaluation.task.laser_noise) == (
        "circuit",
        "circuit",
        0.1,
    )
    with pytest.raises(InputError, match="did you mean 'world'"):
        evaluate(run, settings={"wrld": "circuit"}, episodes=1, steps=2, workers=1)


@pytest.mark.parametrize("simulation", ["bullet", "kinematic"])
def test_the_simulation_can_be_chosen(simulation, run):
    assert evaluate(run, simulation=simulation, episodes=1, steps=2, workers=1).simulation == simulation


def test_an_unknown_simulation_is_refused(run):
    with pytest.raises(InputError, match=r"simulation takes .*'kinematic'.* got 'gazebo'"):
        evaluate(run, simulation="gazebo", episodes=1, steps=2)


def test_the_time_limit_can_be_a_setting(run):
    assert evaluate(run, settings={"episode_steps": 3}, episodes=1, workers=1).steps == 3
    with pytest.raises(InputError, match=r"steps=.* and task\.episode_steps set the same time limit"):
        evaluate(run, settings={"episode_steps": 3}, episodes=1, steps=2)


# ---- models that were trained without tb2rl


@pytest.fixture
def own():
    """A function that makes an untrained model of Stable-Baselines3 for an environment of Gymnasium's."""
    return lambda **arguments: A2C("MlpPolicy", gym.make("tb2rl:TurtleBot2Maze-v0", **arguments))


@pytest.mark.parametrize("observation", ["raw", "discrete"])
@pytest.mark.parametrize("task", ["maze", Wander, Wander(start_clearance=1.0)], ids=["name", "class", "task"])
def test_a_model_of_ones_own_is_evaluated_at_a_task(observation, task, own, outcomes):
    model = own(observation=observation, simulation="kinematic")
    config = resolve("random", settings={"task.observation": observation})
    if isinstance(task, Wander):
        config = config.with_task({"start_clearance": 1.0})
    evaluation = evaluate(model, task=task, episodes=2, steps=10, workers=1)
    assert outcomes(evaluation) == outcomes(evaluate(model, config, episodes=2, steps=10, workers=1))
    assert evaluation.scene.observation == observation


def test_the_task_of_a_model_of_ones_own_has_settings(own):
    model = own(observation="raw", simulation="kinematic", beams=9)
    evaluation = evaluate(model, task="maze", settings={"beams": 9, "world": "circuit"}, episodes=1, steps=3, workers=1)
    assert (evaluation.task.world, evaluation.scene.laser.beams) == ("circuit", 9)
    with pytest.raises(InputError, match="knows the observation Box"):
        evaluate(model, task="maze", episodes=1, steps=3, workers=1)
    with pytest.raises(InputError, match="knows the observation Box"):
        evaluate(model, task="maze", observation="discrete", episodes=1, steps=3, workers=1)


def test_a_policy_of_the_zoo_is_evaluated_at_another_task():
    evaluation = evaluate("zoo:maze-loop-dqn", task="maze", settings={"world": "circuit"}, episodes=1, steps=3)
    assert evaluation.task.world == "circuit"


def test_what_a_model_of_ones_own_is_to_do_is_said_once(own, run):
    with pytest.raises(InputError, match=r"A2C does not come from tb2rl.load or tb2rl.train: name its task"):
        evaluate(own(observation="raw", simulation="kinematic"))
    with pytest.raises(InputError, match="either a config or a task"):
        evaluate(run, resolve(), task="maze")
    with pytest.raises(InputError, match="observation= goes with task="):
        evaluate(run, observation="raw")

"""Fair evaluations: an episode depends on its seed and number alone, and starts where the task says."""

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch as th

from tb2rl import load, make_env
from tb2rl.core.errors import InputError
from tb2rl.envs.scene import Scene, make_scene
from tb2rl.evaluation.evaluate import EPISODES, SEED, STEPS, VALIDATION_SEED, Evaluator, random_initial_states
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.execution.local import LocalExecutor
from tb2rl.robots.turtlebot2 import ROBOT
from tb2rl.runs.algorithm import make_algorithm, make_baseline
from tb2rl.runs.config import Config, resolve
from tb2rl.simulation import InitialState
from tb2rl.simulation.simulator import default_physics
from tb2rl.tasks.wander import Wander
from tb2rl.worlds.registry import find_world

# ---- the same episode anywhere


def make_policy(config: Config):
    """An untrained policy whose actions depend on what it observes."""
    policy = make_algorithm(config).policy
    th.manual_seed(0)
    if hasattr(policy, "q"):
        policy.q[:] = th.rand(policy.q.shape, dtype=th.float64)
        return policy
    for parameter in policy.parameters():
        th.nn.init.normal_(parameter, std=1.0)
    return policy


def make_evaluator(scene: Scene, episodes: int, steps: int, seed: int = SEED, **options) -> Evaluator:
    return Evaluator(scene, random_initial_states(scene, episodes, seed), steps, seed, **{"workers": 1, **options})


def run(config: Config, policy, episodes: int = 3, steps: int = 40, **options) -> Evaluation:
    """An evaluation; kinematic unless the options say otherwise."""
    with make_evaluator(config.scene, episodes, steps, **{"simulation": "kinematic", **options}) as evaluator:
        return evaluator.run(policy)


CAMERA = {"camera": {"width": 36, "height": 36}}
SMALL = {"agent.policy_kwargs.net_arch": [8]}
POLICIES = {
    "table": ("qlearn", "maze", {"task.laser_noise": 0.01}),
    "recurrent": ("sb3_contrib:RecurrentPPO", "maze", {"agent.policy_kwargs.lstm_hidden_size": 8, "train.n_envs": 1}),
    "velocities": ("stable_baselines3:SAC", "cruise", SMALL),
    "many worlds": ("ppo", "wall", {**SMALL, "task.world": "cells", "task.start_clearance": 0.3}),
    "images": ("stable_baselines3:A2C", "maze", {"task.observation": "raw", "task.observe": ["laser", CAMERA]}),
}


@pytest.mark.parametrize(
    ("name", "simulation"),
    [
        ("table", "kinematic"),
        ("table", "bullet"),
        ("recurrent", "kinematic"),
        pytest.param("recurrent", "bullet", marks=pytest.mark.slow),
        ("velocities", "kinematic"),
        ("many worlds", "kinematic"),
        pytest.param("images", "kinematic", marks=pytest.mark.slow),
    ],
)
def test_an_episode_among_others_is_the_same_as_alone(name, simulation, cruise, outcomes):
    agent, task, settings = POLICIES[name]
    config = resolve(agent, cruise if task == "cruise" else task, settings=settings)
    policy, count = make_policy(config), 30 if simulation == "bullet" else 12  # more than the slots of physics
    with make_evaluator(config.scene, count, 40, seed=3, simulation=simulation) as evaluator:
        together, again = evaluator.run(policy), evaluator.run(policy)
    assert (together.simulation, together.seed, together.steps) == (simulation, 3, 40)
    assert outcomes(together) == outcomes(again)
    assert len({episode.start for episode in together.episodes}) == count
    assert len({str(episode.actions) for episode in together.episodes}) > 1
    for number in (0, 5, count - 1):
        states = InitialState(random_initial_states(config.scene, count, 3).table[number : number + 1])
        with Evaluator(config.scene, states, 40, 3 + number, workers=1, simulation=simulation) as evaluator:
            assert outcomes(evaluator.run(policy)) == outcomes(together)[number : number + 1]


@pytest.mark.parametrize(("agent", "simulation"), [("random", "bullet"), ("wallfollower", "kinematic")])
def test_the_result_does_not_depend_on_the_number_of_processes(agent, simulation, outcomes):
    config = resolve(agent, settings={"task.laser_noise": 0.01})
    policy = make_baseline(config)
    alone = run(config, policy, 5, simulation=simulation)
    with make_evaluator(config.scene, 5, 40, simulation=simulation, workers=2) as evaluator:
        shared, again = evaluator.run(policy), evaluator.run(policy)
        with LocalExecutor(2) as executor:
            rest = list(evaluator.run_from(policy, 1, executor))
    assert outcomes(alone) == outcomes(shared) == outcomes(again)
    assert outcomes(replace(alone, episodes=rest)) == outcomes(alone)[1:]


def test_the_steps_of_an_episode_are_those_of_its_record():
    config = resolve("random", settings={"task.laser_noise": 0.01})
    policy = make_baseline(config)
    with make_evaluator(config.scene, 3, 40, simulation="kinematic") as evaluator:
        episode, steps = evaluator.run(policy).episodes[2], evaluator.replay(policy, 2)
    assert [int(step.action) for step in steps] == episode.actions.tolist()
    assert steps[-1].after.pose[0, :2].astype(np.float32).tolist() == episode.path[-1].tolist()
    assert steps[-1].info["ended"] == episode.ended


def test_simulators_make_other_episodes_from_the_same_initial_states(outcomes):
    config = resolve("qlearn", settings={"task.laser_noise": 0.01})
    policy = make_policy(config)
    simulations = ("kinematic", default_physics().name)
    evaluations = [run(config, policy, 4, 20, seed=1, simulation=name) for name in simulations]
    assert outcomes(evaluations[0]) != outcomes(evaluations[1])
    np.testing.assert_allclose(*([episode.start for episode in each.episodes] for each in evaluations), atol=1e-12)


@pytest.mark.bullet
def test_a_robot_that_cannot_be_loaded_is_refused_before_processes_start():
    scene = resolve("wallfollower").scene
    unusable = replace(scene, spec=replace(scene.spec, robot=replace(ROBOT, urdf=Path("missing.urdf"))))
    with pytest.raises(InputError, match=r"robot turtlebot2: .*cannot load missing\.urdf"):
        make_evaluator(unusable, 2, 3, workers=2, simulation="bullet")


# ---- initial states and endings


def test_the_first_initial_states_do_not_depend_on_how_many_follow():
    scene = resolve("pursuit", "navigate", settings={"task.world": "mixed"}).scene
    few, many = (random_initial_states(scene, count, 1).table for count in (7, 130))
    np.testing.assert_array_equal(many[:7], few)
    assert len(np.unique(many, axis=0)) == 130


def test_the_standard_initial_states_are_those_of_the_world_that_training_never_draws():
    assert (EPISODES, STEPS) == (100, 1500)

    def poses(seed: int) -> set[tuple]:
        rng = np.random.default_rng(seed)
        return {
            tuple(row.round(6))
            for row in find_world("loop").sample_poses(rng.random((EPISODES, 4)), Wander().start_clearance)
        }

    standard = {tuple(row.round(6)) for row in random_initial_states(resolve().scene, EPISODES, SEED).pose}
    assert standard == poses(SEED)
    env = make_env("maze", simulation="kinematic")
    training = {tuple(env.reset(seed=seed)[1]["pose"].round(6)) for seed in range(20)}
    env.close()
    assert training & poses(0), "an evaluation of seed 0 would start where a training of seed 0 does"
    assert (training | poses(VALIDATION_SEED)).isdisjoint(standard)


def test_every_episode_has_its_own_start_and_the_time_limit_of_the_evaluation():
    config = resolve("wallfollower", settings={"task.start": "fixed", "task.episode_steps": 7})
    evaluation = run(config, make_baseline(config), 4, 20)
    assert (evaluation.steps, evaluation.task.episode_steps) == (20, 20)
    assert len({episode.start for episode in evaluation.episodes}) == 4
    for episode in evaluation.episodes:
        assert (episode.length, len(episode.path)) == (20, 21)
        assert episode.path[0] == pytest.approx(episode.start[:2], abs=1e-6)
        assert np.linalg.norm(np.diff(episode.path, axis=0), axis=1).sum() == pytest.approx(episode.distance, rel=1e-3)


def test_random_goals_are_farther_than_the_goal_radius():
    config = resolve("pursuit", "navigate", settings={"task.world": {"generator": "clutter", "worlds": 2}})
    states = random_initial_states(config.scene, 12, SEED)
    episodes = run(config, make_baseline(config), 12, 1).episodes
    assert [each.goal for each in episodes] == [tuple(goal) for goal in states.goal.tolist()]
    assert len({(each.world, each.goal) for each in episodes}) > 4
    worlds, paths = states.world.astype(int), states.records["goal_path"].astype(int)
    lengths = config.scene.spec.goal_paths.path_length(worlds, paths, states.pose)
    assert min(lengths) > config.task.goal_radius, "of two random goals it is the farther one"


def test_a_fixed_start_keeps_the_goals_of_the_worlds():
    settings = {"task.world": ["wall", {"generator": "clutter", "worlds": 2}], "task.start": "fixed"}
    config = resolve("pursuit", "navigate", settings=settings)
    episodes, worlds = run(config, make_baseline(config), 12, 1).episodes, config.scene.spec.worlds
    assert [each.goal for each in episodes] == [worlds[each.world].goal[:2] for each in episodes]
    assert len({each.world for each in episodes}) == 3
    assert len({each.start for each in episodes}) == 12


def test_variation_does_not_change_the_start_poses(forward):
    scenes = [make_scene(Wander(variation=variation), "raw") for variation in ("none", "strong")]
    evaluators = [make_evaluator(scene, 4, 2, simulation="kinematic") for scene in scenes]
    one, other = ([episode.start for episode in evaluator.run(forward).episodes] for evaluator in evaluators)
    assert one == other


def test_a_task_with_initial_states_of_its_own_is_evaluated_from_them(northward, forward):
    episodes = run(resolve("random", northward), forward, 4, 3).episodes
    assert [episode.start[2] for episode in episodes] == [math.pi / 2] * 4
    assert len({episode.start[:2] for episode in episodes}) == 4
    for episode in episodes:
        steps = np.diff(episode.path, axis=0)
        assert (np.abs(steps[:, 0]) < 0.01).all()
        assert (steps[1:, 1] > 0.02).all(), "it drives along y"


# ---- policies


def test_anything_that_predicts_is_evaluated(forward):
    episodes = run(resolve(), forward, 3, 200, simulation=default_physics().name).episodes
    assert [(episode.ended, episode.failed) for episode in episodes] == [("collision", True)] * 3
    assert [episode.episode_return for episode in episodes] == [5.0 * (e.length - 1) - 200.0 for e in episodes]
    assert [episode.actions.tolist() for episode in episodes] == [[0] * e.length for e in episodes]
    assert {episode.actions.dtype for episode in episodes} == {np.dtype(np.uint8)}


def test_continuous_actions_are_recorded_as_given(cruise):
    config = resolve("random", cruise)
    for episode in run(config, make_baseline(config)).episodes:
        assert (episode.actions.shape, episode.actions.dtype) == ((episode.length, 2), np.float32)
        assert np.abs(episode.actions).max() <= 1.0
        assert len(np.unique(episode.actions, axis=0)) == episode.length
        assert 0.0 < episode.distance <= 0.5 * 0.2 * episode.length


@pytest.mark.slow
def test_a_thousand_episodes_of_a_table_take_less_than_two_seconds():
    policy = load("zoo:maze-loop-qlearn")
    seconds = []
    with make_evaluator(policy.trained_with.scene, 1000, 1000, simulation="kinematic") as evaluator:
        for _ in range(4):
            started = time.process_time()
            evaluator.run(policy.policy)
            seconds.append(time.process_time() - started)
    assert min(seconds) < 2.0

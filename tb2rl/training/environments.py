"""The environments of a training, and the evaluator of its evaluations."""

from __future__ import annotations

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import has_images
from tb2rl.envs.scene import Scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.evaluation.evaluator import TRAINING_SEED, Evaluator, random_initial_states
from tb2rl.runs.config import TrainSettings
from tb2rl.simulation import default_simulator, find_simulator

_MANY, _FEW = 1000, 20  # episodes of an evaluation in a fast and in a slow simulator


def make_vec_env(scene: Scene, settings: TrainSettings) -> TurtleBot2VecEnv:
    """The environments of a training."""
    if settings.episode_steps is not None:
        scene = scene.with_time_limit(settings.episode_steps)
    simulator = find_simulator(settings.simulation)
    simulator.check(f"a training in simulation {settings.simulation!r}")
    return TurtleBot2VecEnv(scene, settings.n_envs, settings.reward_scale, simulator)


def make_evaluator(scene: Scene, settings: TrainSettings, seed: int = TRAINING_SEED) -> Evaluator:
    """The evaluator of a training.

    Args:
        scene: In the worlds of the evaluations.
        settings: Of the training.
        seed: Of initial states and noise.
    """
    simulator = find_simulator(settings.eval_simulation)
    try:
        scene.check(simulator)
    except InputError as error:
        simulator = default_simulator()
        print(f"evaluations while training use {simulator.title}, and are slower: {error}", flush=True)
    slow = simulator.in_processes or has_images(scene.observation_space)
    states = random_initial_states(scene, settings.eval_episodes or (_FEW if slow else _MANY), seed)
    return Evaluator(scene, states, settings.eval_steps, seed, simulation=simulator)

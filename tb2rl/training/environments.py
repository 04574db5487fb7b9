"""The environments of a training, and the evaluator of its evaluations."""

from __future__ import annotations

from tb2rl.core.errors import InputError
from tb2rl.envs.encodings import has_images
from tb2rl.envs.scene import Scene
from tb2rl.envs.vec_env import TurtleBot2VecEnv
from tb2rl.evaluation.evaluator import TRAINING_SEED, Evaluator, random_initial_states
from tb2rl.runs.config import TrainSettings
from tb2rl.simulation import default_simulator, find_simulator
from tb2rl.worlds.generators import Purpose

_MANY, _FEW = 1000, 20  # episodes of an evaluation: if all drive at once, and if a step takes time


def make_vec_env(scene: Scene, settings: TrainSettings) -> TurtleBot2VecEnv:
    """The environments of a training."""
    if settings.episode_steps is not None:
        scene = scene.changed(episode_steps=settings.episode_steps)
    simulator = find_simulator(settings.simulation)
    simulator.check(f"a training in simulation {settings.simulation!r}")
    return TurtleBot2VecEnv(scene, settings.n_envs, settings.reward_scale, simulator)


def make_evaluator(
    scene: Scene, settings: TrainSettings, purpose: Purpose = "validation", seed: int = TRAINING_SEED
) -> Evaluator:
    """The evaluator that a training's settings describe.

    Args:
        scene: Of the training.
        settings: Of the training.
        purpose: Of the worlds, if they are generated. Validation worlds decide which policy of a training is the best.
        seed: Of initial states and noise.
    """
    scene, simulator = scene.worlds_for(purpose), find_simulator(settings.eval_simulation)
    try:
        scene.check(simulator)
    except InputError as error:
        simulator = default_simulator()
        print(f"evaluations on the way use {simulator.title}, and are slower: {error}", flush=True)
    slow = simulator.in_processes or has_images(scene.observation_space)
    states = random_initial_states(scene, settings.eval_episodes or (_FEW if slow else _MANY), seed)
    return Evaluator(scene, states, settings.eval_steps, seed, simulation=simulator)

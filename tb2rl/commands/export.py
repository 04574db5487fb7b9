"""Implementation of `python -m tb2rl.export`: policies as ONNX files and as folders for robots."""

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core import InputError, check_output
from tb2rl.core.errors import install_extra
from tb2rl.core.files import atomic_write
from tb2rl.deploy.description import describe, find_portable_needs
from tb2rl.deploy.folder import write_folder
from tb2rl.deploy.network import OBSERVATION, extract_network, observation_spaces
from tb2rl.deploy.portable.policy import Network
from tb2rl.envs.encodings import has_images, stack_observations
from tb2rl.envs.parts import describe_filters, robot_facts
from tb2rl.runs.loading import config_of, load

# The check of an export compares actions for random observations; few images, because onnx's evaluator is slow.
_NUM_OBSERVATIONS, _NUM_IMAGES = 100, 4
_TOLERANCE = 1e-4  # actions that differ by less count as equal
_MAX_DIFFERENT = 0.05  # maximum share of actions that differ by more than the tolerance, because of rounding


def export_onnx(reference: str | Path, file: Path, trust: bool = False) -> None:
    """Write a policy as an ONNX file, see `tb2rl.deploy.graph`."""
    check_output(file)
    try:
        from onnx.reference import ReferenceEvaluator

        from tb2rl.deploy.graph import build_graph
    except ImportError:
        raise InputError(f"writing an .onnx file needs onnx: {install_extra('export')}") from None
    policy = load(reference, trust)
    config, input_spaces = config_of(policy), observation_spaces(policy.observation_space)
    metadata = {**describe(config, str(reference)), "config": config.to_dict()}
    metadata |= {"control_period": config.task.control_period, "beams": config.scene.laser.angles.tolist()}
    model = build_graph(extract_network(policy), input_spaces, config.scene.actions, metadata)
    graph: Any = ReferenceEvaluator(model)
    # After the observation, the inputs of the graph are LSTM states, shape (1, num_envs, units).
    lstm_units = {t.name: t.type.tensor_type.shape.dim[2].dim_value for t in model.graph.input[len(input_spaces) :]}

    def act(observations: Mapping[str, np.ndarray]) -> np.ndarray:
        num_envs = len(next(iter(observations.values())))
        initial_states = {name: np.zeros((1, num_envs, units), np.float32) for name, units in lstm_units.items()}
        return graph.run(["action"], {**observations, **initial_states})[0]

    _check_same_actions(act, policy)
    with atomic_write(file) as temporary:
        temporary.write_bytes(model.SerializeToString())


def export_folder(reference: str | Path, folder: Path, trust: bool = False) -> None:
    """Write a policy as a folder for a robot, see `tb2rl.deploy.folder`."""
    policy = load(reference, trust)
    config = config_of(policy)
    needs, network = find_portable_needs(config), extract_network(policy)
    portable = Network(network.sequence())
    _check_same_actions(lambda observations: portable(observations[OBSERVATION]), policy)
    filters, files = describe_filters(config.task, config.scene.spec)
    facts = robot_facts(config.task, config.scene.spec)
    description = {**describe(config, str(reference)), "filters": filters, "safety": facts}
    write_folder(folder, network, description, needs, files)


def _check_same_actions(act: Callable[[Mapping[str, np.ndarray]], np.ndarray], policy: BaseAlgorithm) -> None:
    """Raise an `InputError` if the export acts unlike the policy, whose class may compute more than its layers."""
    space = policy.observation_space
    space.seed(0)
    num_samples = _NUM_IMAGES if has_images(space) else _NUM_OBSERVATIONS
    observations = stack_observations([space.sample() for _ in range(num_samples)])
    expected, _ = policy.predict(observations, deterministic=True)
    actions = act(observations if isinstance(observations, dict) else {OBSERVATION: observations})
    if np.mean(np.abs(actions - expected) > _TOLERANCE) > _MAX_DIFFERENT:
        name = type(policy.policy).__name__
        raise InputError(f"{name} cannot be exported, because it computes more than its layers: the actions differ")


def run(options: argparse.Namespace) -> None:
    """Export a policy."""
    if options.target.suffix == ".onnx":
        export_onnx(options.policy, options.target, options.trust)
        print(f"wrote {options.target}")
    else:
        export_folder(options.policy, options.target, options.trust)
        print(f"wrote {options.target}; its README.md explains how to drive a robot with it")

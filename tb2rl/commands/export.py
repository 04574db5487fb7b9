"""Runs `export`, see `tb2rl.export`: writes policies as ONNX files and as folders for robots."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.files import replacing
from tb2rl.core.plugins import agent_names
from tb2rl.deploy.description import describe, portable_needs
from tb2rl.deploy.folder import write_folder
from tb2rl.deploy.network import OBSERVATION, network_of, parts_of
from tb2rl.deploy.portable.network import Network
from tb2rl.envs.encodings import has_images, stacked
from tb2rl.envs.task_filters import describe_filters
from tb2rl.runs.loading import config_of, load

_OBSERVATIONS, _IMAGES = 100, 4  # for the check of an export; onnx's own evaluator is slow
_TOLERANCE, _SHARE = 1e-4, 0.05  # a share of the actions may differ by more, because of rounding


def export_onnx(reference: str | Path, file: Path, trust: bool = False) -> None:
    """Write a policy as an ONNX file, see `tb2rl.deploy.graph`.

    Raises:
        InputError: If there is no such policy, it cannot be exported, or onnx is not installed.
        OSError: If the file cannot be written.
    """
    if not file.absolute().parent.is_dir() or file.is_dir():
        raise InputError(f"cannot write {file}: it is a folder, or its folder does not exist")
    try:
        from onnx.reference import ReferenceEvaluator

        from tb2rl.deploy.graph import graph_of
    except ImportError:
        raise InputError("an .onnx file needs onnx, which is not installed: pip install onnx") from None
    policy = _load(reference, trust)
    config, parts = config_of(policy), parts_of(policy.observation_space)
    training = {"control_period": config.task.control_period, "beams": config.scene.laser.angles.tolist()}
    about = {**describe(config, str(reference)), **training, "config": config.to_dict()}
    model = graph_of(network_of(policy), parts, config.scene.actions, about)
    graph: Any = ReferenceEvaluator(model)
    memory = {each.name: each.type.tensor_type.shape.dim[2].dim_value for each in model.graph.input[len(parts) :]}

    def act(observations: Mapping[str, np.ndarray]) -> np.ndarray:
        num_envs = len(next(iter(observations.values())))
        empty = {name: np.zeros((1, num_envs, units), np.float32) for name, units in memory.items()}
        return graph.run(["action"], {**observations, **empty})[0]

    _check_same_actions(act, policy)
    with replacing(file) as temporary:
        temporary.write_bytes(model.SerializeToString())


def export_folder(reference: str | Path, folder: Path, trust: bool = False) -> None:
    """Write a policy as a folder for a robot, see `tb2rl.deploy.folder`.

    Raises:
        InputError: If there is no such policy, or it cannot be exported.
        OSError: If the folder cannot be written.
    """
    policy = _load(reference, trust)
    config = config_of(policy)
    needs, network = portable_needs(config), network_of(policy)
    portable = Network([(layer.kind, layer.arrays) for layer in network.sequence()])
    _check_same_actions(lambda observations: portable(observations[OBSERVATION]), policy)
    filters, files = describe_filters(config.task)
    write_folder(folder, network, {**describe(config, str(reference)), "filters": filters}, needs, files)


def _load(reference: str | Path, trust: bool) -> BaseAlgorithm:
    name = str(reference)
    if name in agent_names() and not Path(name).exists():
        hint = "export a run folder of it" if find_agent(name).algorithm else "it does not learn, so it has no policy"
        raise InputError(f"{name} is the name of an agent: {hint}")
    return load(reference, trust)


def _check_same_actions(act: Callable[[Mapping[str, np.ndarray]], np.ndarray], policy: BaseAlgorithm) -> None:
    """Compare the actions of the exported layers and the policy, whose class may compute more than its layers.

    Raises:
        InputError: If the actions differ.
    """
    space = policy.observation_space
    space.seed(0)
    observations = stacked([space.sample() for _ in range(_IMAGES if has_images(space) else _OBSERVATIONS)])
    expected, _ = policy.predict(observations, deterministic=True)
    actions = act(observations if isinstance(observations, dict) else {OBSERVATION: observations})
    if np.mean(np.abs(actions - expected) > _TOLERANCE) > _SHARE:
        kind = type(policy.policy).__name__
        raise InputError(f"the layers of {kind} do not act as it does: it computes what cannot be exported")


def run(options: argparse.Namespace) -> None:
    """Export a policy."""
    target: Path = options.target
    if target.suffix == ".onnx":
        export_onnx(options.policy, target, options.trust)
        print(f"wrote {target}")
    else:
        export_folder(options.policy, target, options.trust)
        print(f"wrote {target}; its README.md says how to drive a robot with it")

"""The command `convert`, see `tb2rl.convert`: policies to zips of Stable-Baselines3, and back."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError, one_line
from tb2rl.core.plugins import import_object
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.config import config_from
from tb2rl.runs.folder import Run
from tb2rl.runs.hub import HUB
from tb2rl.runs.layers import parse_settings, resolve
from tb2rl.runs.loading import load
from tb2rl.runs.parameters import load_parameters


def export_policy(reference: str | Path, file: Path, trust: bool = False) -> list[Path]:
    """Write a policy as a zip that its algorithm's own `load` opens, for example `stable_baselines3.DQN.load`.

    Returns:
        The files: the zip, and if the policy normalises observations one for `VecNormalize.load`.

    Raises:
        InputError: If there is no such policy, or the file cannot be written.
    """
    algorithm = load(reference, trust)
    if not file.absolute().parent.is_dir() or file.is_dir():
        raise InputError(f"cannot write {file}: it is a folder, or its folder does not exist")
    if hasattr(algorithm, "replay_buffer_class"):
        algorithm.replay_buffer_class = None  # Stable-Baselines3 chooses it again, and warns about a stored one
    files = [file]
    try:
        algorithm.save(file)
        if env := algorithm.get_vec_normalize_env():
            files.append(file.with_name(f"{file.stem}-vecnormalize.pkl"))
            env.save(str(files[-1]))
    except OSError as error:
        raise InputError(f"cannot write {file}: {error.strerror or error}") from None
    return files


def import_policy(
    file: Path, folder: Path, agent: str, task: str | None = None, settings: Mapping[str, Any] | None = None
) -> Run:
    """Make a run folder from a zip of Stable-Baselines3. This executes the code in the zip.

    Args:
        file: The zip.
        folder: The run folder to make.
        agent: The agent whose algorithm wrote it.
        task: The task of its training; None: `maze`.
        settings: Settings of the task, by dotted key.

    Raises:
        InputError: If it is not such a zip, or its spaces differ from those of the task.
    """
    algorithm = find_agent(agent).algorithm
    if algorithm is None:
        raise InputError(f"agent {agent} does not learn, so it has no zip")
    if not file.is_file():
        raise InputError(f"there is no file {file}")
    try:
        theirs: BaseAlgorithm = import_object(algorithm).load(file, device="cpu")
    except Exception as error:  # the code in the zip can raise any
        raise InputError(f"{file} is not a zip of {algorithm} ({type(error).__name__})") from None
    tree = resolve(agent, task, settings=settings).to_dict()
    tree["agent"] = {"name": agent, "policy_kwargs": _plain(theirs.policy_kwargs)}
    if theirs.use_sde:
        tree["agent"]["use_sde"] = True
    config = config_from(tree)
    ours = make_algorithm(config, Spaces.vectorised(config))
    for kind, expected, found in (
        ("observations", ours.observation_space, theirs.observation_space),
        ("actions", ours.action_space, theirs.action_space),
    ):
        if expected != found:
            raise InputError(one_line(f"{file} has other {kind} than the task: {found}, not {expected}"))
    weights = {key: tensor.cpu().numpy() for key, tensor in theirs.policy.state_dict().items()}
    load_parameters(ours, {"timesteps": theirs.num_timesteps, "policy": weights}, file)
    run = Run.create(folder, config)
    run.save(ours, "final/policy")
    return run


def _plain(value: Any) -> Any:
    """Convert policy arguments to values of a config: a class becomes "module:Class"."""
    if isinstance(value, type):
        return f"{value.__module__}:{value.__qualname__}"
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, list | tuple) else value


def run(options: argparse.Namespace) -> None:
    """Convert a policy to a zip, or with `--trust` a zip to a run."""
    on_hub = options.source.startswith(HUB)
    if options.trust and not on_hub:
        if not options.agent:
            raise InputError("--trust needs --agent, the agent whose algorithm wrote the zip")
        settings = parse_settings(options.set)
        run = import_policy(Path(options.source), options.target, options.agent, options.task, settings)
        print(f"made {run.folder}; evaluate it with: python -m tb2rl.evaluate {run.folder}")
        return
    if options.agent or options.task or options.set:
        raise InputError("--agent, --task and --set go with --trust")
    if Path(options.source).suffix == ".zip" and not on_hub:
        raise InputError(f"loading {options.source} executes the code in it; pass --trust to allow it")
    for file in export_policy(options.source, options.target, options.trust):
        print(f"wrote {file}")

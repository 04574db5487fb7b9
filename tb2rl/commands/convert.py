"""Implementation of `python -m tb2rl.convert`: policies to zips of Stable-Baselines3, and back."""

import argparse
import json
from pathlib import Path

from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.commands.arguments import refuse
from tb2rl.core import InputError, check_output, find_agent, import_object, reference_to
from tb2rl.evaluation.episodes import check_spaces
from tb2rl.runs import HUB, Run, config_from, load, load_parameters, make_algorithm, parse_settings, resolve


def export_policy(reference: str | Path, file: Path, trust: bool = False) -> list[Path]:
    """Write a policy as a zip for `load` of its Stable-Baselines3 algorithm, for example `stable_baselines3.DQN.load`.

    Returns:
        The files: the zip, and a file for `VecNormalize.load` if the policy normalises observations.

    Raises:
        InputError: If there is no such policy, or the file cannot be written.
    """
    algorithm = load(reference, trust)
    check_output(file)
    if hasattr(algorithm, "replay_buffer_class"):
        algorithm.replay_buffer_class = None  # Stable-Baselines3's `load` selects one; it can warn about a stored one
    algorithm.save(file)
    env = algorithm.get_vec_normalize_env()
    if env is None:
        return [file]
    statistics = file.with_name(f"{file.stem}-vecnormalize.pkl")
    env.save(str(statistics))
    return [file, statistics]


def _import_policy(file: Path, options: argparse.Namespace) -> None:
    """Make a run folder from a zip of Stable-Baselines3. This executes the code in the zip."""
    reference = find_agent(options.agent).algorithm
    if reference is None:
        raise InputError(f"agent {options.agent} does not learn, so there is no zip to load; give a learning --agent")
    try:
        original: BaseAlgorithm = import_object(reference).load(file, device="cpu")
        policy_kwargs = json.loads(json.dumps(original.policy_kwargs, default=reference_to))  # classes as strings
    except Exception as error:  # the code in the zip can raise any exception
        raise InputError(f"cannot load {file} as a zip of {reference} ({type(error).__name__})") from None
    tree = resolve(options.agent, options.task, settings=parse_settings(options.set)).to_dict()
    sde = {"use_sde": True} if original.use_sde else {}
    config = config_from(tree | {"agent": {"name": options.agent, "policy_kwargs": policy_kwargs, **sde}})
    check_spaces(original, config.scene)
    algorithm = make_algorithm(config)
    weights = {key: tensor.cpu().numpy() for key, tensor in original.policy.state_dict().items()}
    load_parameters(algorithm, {"timesteps": original.num_timesteps, "policy": weights}, file)
    run = Run.create(options.target, config)
    run.save(algorithm, "final/policy")
    print(f"made {run.folder}; evaluate it with: python -m tb2rl.evaluate {run.folder}")


def run(options: argparse.Namespace) -> None:
    """Convert a policy to a zip, or with `--trust` a local zip to a run."""
    source, is_on_hub = Path(options.source), options.source.startswith(HUB)
    if options.trust and not is_on_hub:
        if not options.agent:
            raise InputError("--trust needs --agent, the agent whose algorithm wrote the zip")
        _import_policy(source, options)
        return
    refuse(options, "is for a local zip with --trust", "agent", "task", "set")
    if source.suffix == ".zip" and not is_on_hub:
        raise InputError(f"loading {options.source} executes code in the zip; pass --trust to allow it")
    for file in export_policy(options.source, options.target, options.trust):
        print(f"wrote {file}")

"""Loading of policies from a run folder, a checkpoint, the zoo or the hub.

A checkpoint holds only arrays and plain values: the algorithm is created from its config, which names modules to import
(see `tb2rl.core.trust` for configs that somebody shared).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core.errors import InputError, one_line, unknown
from tb2rl.core.files import top_folder
from tb2rl.core.trust import untrusted_source
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.arguments import LIBRARY_ERRORS
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.folder import CONFIG, SHARED, Run, is_shared, read_config, restrict_imports
from tb2rl.runs.hub import HUB, POLICY, cached_reference, download
from tb2rl.runs.normalisation import driving_policy
from tb2rl.runs.parameters import load_parameters


def load(reference: str | Path, trust: bool = False) -> BaseAlgorithm:
    """A trained agent, ready to `predict`; `make_env` of it gives the environment that it was trained in.

    With `train.norm_obs` it normalises its observations itself: to train it further, resume its run.

    Args:
        reference: A run folder (its best policy), a checkpoint in it, "zoo:NAME", or "hf:user/repository", which is
            downloaded ("hf:user/repository@revision" for one revision).
        trust: Whether to import any module that a shared policy names, instead of only modules of tb2rl,
            Stable-Baselines3, sb3-contrib, torch and installed plugins.

    Raises:
        InputError: If there is no such policy, or it is damaged.
    """
    file = checkpoint_file(reference, trust)
    name = str(reference)  # names the origin in messages
    with untrusted_source(name) if name.startswith(HUB) and not trust else nullcontext():
        return _load_file(file, trust)


def _load_file(file: Path, trust: bool) -> BaseAlgorithm:
    content = read_checkpoint(file)
    config = content_config(content, file, trust)
    folder = run_folder(file)
    if folder and is_shared(folder):  # the config that people read must be the one that is used
        shown = {key: value for key, value in read_config(folder).items() if key != "versions"}
        if shown != content["config"]:
            raise InputError(f"{folder}: {SHARED} is not what its policy was trained with")
    try:
        algorithm = make_algorithm(config, Spaces.vectorised(config))
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    load_parameters(algorithm, {**content, "training": None}, file)
    algorithm.policy = driving_policy(algorithm)
    if env := algorithm.get_vec_normalize_env():
        env.training = False
    algorithm.trained_with = config  # type: ignore[attr-defined]
    return algorithm


def checkpoint_file(reference: str | Path, trust: bool = False) -> Path:
    """The checkpoint of a reference, see `load`."""
    name = str(reference)
    if name.startswith("zoo:"):
        entries = {entry.name: entry for entry in top_folder("zoo").iterdir() if (entry / CONFIG).is_file()}
        if name[4:] not in entries:
            raise unknown("zoo policy", name[4:], entries)
        return Run.open(entries[name[4:]]).policy_file
    if name.startswith(HUB):
        return download(name) / POLICY
    path = Path(reference)
    if path.is_dir():
        return Run.open(path, trust).policy_file
    if not path.is_file():
        raise InputError(f"there is no run folder or checkpoint {name}")
    return path


def run_folder(file: Path) -> Path | None:
    """The run folder of a checkpoint; None if it lies elsewhere."""
    folder = file.absolute().parent.parent
    return folder if any((folder / name).is_file() for name in (CONFIG, SHARED)) else None


def policy_digest(reference: str | Path, trust: bool = False) -> str:
    """SHA-256 of the checkpoint of a reference, see `load`."""
    return hashlib.sha256(checkpoint_file(reference, trust).read_bytes()).hexdigest()


def content_config(content: Mapping[str, Any], file: Path, trust: bool = False) -> Config:
    """The config in the content of a checkpoint file, which must also have its number of timesteps.

    Raises:
        InputError: If one of these is missing or does not fit.
    """
    folder = run_folder(file)
    where = (folder and cached_reference(folder)) or file
    try:
        timesteps = content["timesteps"]
        if type(timesteps) is not int or timesteps < 0:
            raise InputError(f"timesteps is {timesteps!r}")
        with restrict_imports(folder, trust):
            return config_from(content["config"])
    except (*LIBRARY_ERRORS, ImportError) as error:  # an InputError is a ValueError
        raise InputError(one_line(f"{where} does not hold a config that fits: {error}")) from None


def config_of(policy: Any) -> Config:
    """The config of a policy from `load` or `train`.

    Raises:
        InputError: If it comes from elsewhere.
    """
    config = getattr(policy, "trained_with", None)
    if not isinstance(config, Config):
        raise InputError(f"{type(policy).__name__} does not come from tb2rl.load or tb2rl.train, so it has no config")
    return config

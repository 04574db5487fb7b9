"""How a policy comes back from a run folder, a checkpoint, the zoo or the hub.

A checkpoint holds arrays and plain values only: the algorithm is rebuilt from its config through the registry, which
imports the modules that the config names; for one that somebody shared, see `tb2rl.core.trust`.
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
from tb2rl.core.trust import distrusting
from tb2rl.runs.algorithm import Spaces, make_algorithm
from tb2rl.runs.arguments import LIBRARY_ERRORS
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.folder import CONFIG, SHARED, Run, imports_limited, is_shared, read_config
from tb2rl.runs.hub import HUB, POLICY, downloaded, name_of
from tb2rl.runs.normalisation import driving_policy
from tb2rl.runs.parameters import load_parameters


def load(reference: str | Path, trust: bool = False) -> BaseAlgorithm:
    """A trained agent, ready to `predict`; `make_env` of it gives the environment that it was trained in.

    With `train.norm_obs` it normalises what it is given by itself: to train it further, resume its run.

    Args:
        reference: A run folder (its best policy), a checkpoint in it, "zoo:NAME", or "hf:user/repository", which is
            downloaded ("hf:user/repository@revision" is one state of it).
        trust: Whether to import whatever a policy that somebody shared names, and not only modules of tb2rl,
            Stable-Baselines3, sb3-contrib, torch and installed plugins.

    Raises:
        InputError: If it is not one of these, or does not hold what it should.
    """
    file = checkpoint_file(reference, trust)
    name = str(reference)  # by which a message calls whoever shared it
    with distrusting(name) if name.startswith(HUB) and not trust else nullcontext():
        return _restored(file, trust)


def _restored(file: Path, trust: bool) -> BaseAlgorithm:
    content = read_checkpoint(file)
    config = content_config(content, file, trust)
    folder = run_folder(file)
    if folder and is_shared(folder):  # what people and reports read is what drives
        said = {key: value for key, value in read_config(folder).items() if key != "versions"}
        if said != content["config"]:
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
    """The file that a reference to a policy means, see `load`.

    Raises:
        InputError: If there is no such file.
    """
    name = str(reference)
    if name.startswith("zoo:"):
        entries = {entry.name: entry for entry in top_folder("zoo").iterdir() if (entry / "config.yaml").is_file()}
        if name[4:] not in entries:
            raise unknown("zoo policy", name[4:], entries)
        return Run.open(entries[name[4:]]).policy_file
    if name.startswith(HUB):
        return downloaded(name) / POLICY
    path = Path(reference)
    if path.is_dir():
        return Run.open(path, trust).policy_file
    if not path.is_file():
        raise InputError(f"there is no run folder or checkpoint {name}")
    return path


def run_folder(file: Path) -> Path | None:
    """The run folder that a checkpoint lies in; None: it lies elsewhere."""
    folder = file.absolute().parent.parent
    return folder if any((folder / name).is_file() for name in (CONFIG, SHARED)) else None


def policy_digest(reference: str | Path, trust: bool = False) -> str:
    """SHA-256 of the file that a reference to a policy means, see `load`.

    Raises:
        InputError: If there is no such file.
    """
    return hashlib.sha256(checkpoint_file(reference, trust).read_bytes()).hexdigest()


def content_config(content: Mapping[str, Any], file: Path, trust: bool = False) -> Config:
    """The config in a checkpoint, which must also say how many timesteps it has.

    Args:
        content: Of the checkpoint.
        file: Where it comes from.
        trust: Whether to import whatever it names, if somebody shared it.

    Raises:
        InputError: If one of these is missing or does not fit.
    """
    folder = run_folder(file)
    where = (folder and name_of(folder)) or file
    try:
        timesteps = content["timesteps"]
        if type(timesteps) is not int or timesteps < 0:
            raise InputError(f"timesteps is {timesteps!r}")
        with imports_limited(folder, trust):
            return config_from(content["config"])
    except (*LIBRARY_ERRORS, ImportError) as error:  # an InputError is a ValueError
        raise InputError(one_line(f"{where} does not hold a config that fits: {error}")) from None


def config_of(policy: Any) -> Config:
    """What a policy from `load` or `train` was trained to do.

    Raises:
        InputError: If it does not come from one of these.
    """
    config = getattr(policy, "trained_with", None)
    if not isinstance(config, Config):
        raise InputError(f"{type(policy).__name__} does not come from tb2rl.load or tb2rl.train, so it has no config")
    return config

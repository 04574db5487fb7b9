"""Loads policies from a run folder, a checkpoint, the zoo or the Hugging Face hub.

A checkpoint contains only arrays and plain values. The algorithm is created from the config in the checkpoint. A config
refers to modules to import; `tb2rl.core.trust` restricts these modules for shared configs.

A policy on the hub is "hf:user/repository" or "hf:user/repository@revision". A repository contains the files of a
shared run folder, see `tb2rl.runs.folder`. huggingface_hub downloads only `_DOWNLOADED_FILES`, which contain no code,
into its own cache. The cache also works offline.
"""

import hashlib
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from logging import CRITICAL
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm

from tb2rl.core import InputError, one_line, top_folder, unknown, untrusted_source
from tb2rl.core.errors import install_extra
from tb2rl.core.values import CountOrZero, checked
from tb2rl.runs.algorithm import load_statistics, make_algorithm, policy_with_normalization
from tb2rl.runs.arguments import LIBRARY_ERRORS
from tb2rl.runs.checkpoint import read_checkpoint
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.folder import CONFIG, EVALUATION, SHARED_CONFIG, TRAINING_EVALUATIONS, Run, is_shared, restrict_imports

HUB = "hf:"  # prefix of references
POLICY = "best/policy.safetensors"  # path of the checkpoint in a repository
_DOWNLOADED_FILES = [SHARED_CONFIG, POLICY, EVALUATION, TRAINING_EVALUATIONS]
_REFERENCE = re.compile(r"hf:([\w.-]+/[\w.-]+)(?:@([\w./-]+))?")


def load(reference: str | Path, trust: bool = False) -> BaseAlgorithm:
    """Load a trained agent, ready to `predict`; `make_env` makes the environment of its training.

    A policy trained with `train.norm_obs` normalises its observations itself. To continue a training, resume its run.

    Args:
        reference: A run folder (its best policy is loaded), a checkpoint, "zoo:NAME", or a policy on the hub,
            "hf:user/repository" or "hf:user/repository@revision".
        trust: Whether a shared policy may import any module, instead of only modules of tb2rl, Stable-Baselines3,
            sb3-contrib, torch and installed plugins.

    Raises:
        InputError: If the policy does not exist, is damaged, or needs `trust`.
    """
    file, source = checkpoint_file(reference, trust), str(reference)
    with untrusted_source(source) if source.startswith(HUB) and not trust else nullcontext():
        content, folder = read_checkpoint(file), run_folder(file)
        config = checkpoint_config(content, file, trust)
        # People review only the config file, so it must equal the config in the checkpoint.
        if folder and is_shared(folder) and Run.open(folder, trust).config != config:
            raise InputError(f"{folder}: {SHARED_CONFIG} differs from the config that its policy was trained with")
        try:
            with _skip_compiler():
                algorithm = make_algorithm(config)
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
    load_parameters(algorithm, {**content, "training": None}, file)  # without the state to resume from
    algorithm.policy = policy_with_normalization(algorithm)
    algorithm.observation_space = algorithm.policy.observation_space  # without privileged sensors
    if env := algorithm.get_vec_normalize_env():
        env.training = False
    algorithm.trained_with = config  # type: ignore[attr-defined]
    return algorithm


@contextmanager
def _skip_compiler() -> Iterator[None]:
    """Make optimisers without the import of PyTorch's compiler, which takes 1.6 s, and which a policy does not need.

    PyTorch imports it to wrap the function below, unless the function has a wrapper already.
    """
    function: Any = getattr(th.optim.Optimizer.add_param_group, "__wrapped__", None)
    if function is None or hasattr(function, "__dynamo_disable"):
        yield
        return
    setattr(function, "__dynamo_disable", function)
    try:
        yield
    finally:
        delattr(function, "__dynamo_disable")


def checkpoint_file(reference: str | Path, trust: bool = False) -> Path:
    """Find or download the checkpoint of a reference, see `load`."""
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
    """The run folder of a checkpoint; None for a checkpoint outside a run folder."""
    folder = file.absolute().parent.parent
    return folder if any((folder / name).is_file() for name in (CONFIG, SHARED_CONFIG)) else None


def policy_digest(reference: str | Path, trust: bool = False) -> str:
    """SHA-256 of the checkpoint of a reference, see `load`."""
    return hashlib.sha256(checkpoint_file(reference, trust).read_bytes()).hexdigest()


def checkpoint_config(content: Mapping[str, Any], file: Path, trust: bool = False) -> Config:
    """The config in the content of a checkpoint file; raises an `InputError` if config or timesteps are invalid."""
    folder = run_folder(file)
    source = (folder and cached_reference(folder)) or file
    try:
        checked(CountOrZero, content["timesteps"], "timesteps")
        with restrict_imports(folder, trust):
            return config_from(content["config"])
    except (*LIBRARY_ERRORS, ImportError) as error:
        raise InputError(one_line(f"{source} has an invalid config or number of timesteps: {error}")) from None


def config_of(policy: Any) -> Config:
    """The config of a policy from `load` or `train`; raises an `InputError` for any other policy."""
    config = getattr(policy, "trained_with", None)
    if not isinstance(config, Config):
        raise InputError(f"{type(policy).__name__} does not come from tb2rl.load or tb2rl.train, so it has no config")
    return config


# ---- learned parameters: weights of the policy, states of optimisers, and further tensors


def parameters_of(algorithm: BaseAlgorithm) -> dict[str, Any]:
    """The learned parameters outside the policy, as a tree for `write_checkpoint`.

    "others" are the states of optimisers and other parts that Stable-Baselines3 saves. "tensors" are single tensors,
    such as the entropy coefficient of SAC.
    """
    others = {name: state for name, state in algorithm.get_parameters().items() if name != "policy"}
    return {"others": others, "tensors": _single_tensors(algorithm)}


def load_parameters(algorithm: BaseAlgorithm, content: Mapping[str, Any], file: Path) -> None:
    """Load the parameters, statistics and number of timesteps of a checkpoint into the algorithm of its config.

    Args:
        algorithm: Algorithm to change.
        content: Content of the checkpoint; "training" is optional, and so is "normalisation" without `VecNormalize`.
        file: The checkpoint, for messages.
    """
    try:
        algorithm.num_timesteps = int(content["timesteps"])
        algorithm.policy.load_state_dict(_tensors(content["policy"]))
        load_statistics(algorithm, content.get("normalisation"))
        if training := content.get("training"):
            for name in algorithm.get_parameters().keys() - {"policy"}:
                part, saved_state = attrgetter(name)(algorithm), training["others"][name]
                is_optimizer = isinstance(part, th.optim.Optimizer)
                part.load_state_dict(_optimizer_state(part, saved_state) if is_optimizer else _tensors(saved_state))
            for name, tensor in _single_tensors(algorithm).items():
                with th.no_grad():  # in place, because the optimiser refers to this tensor
                    tensor.copy_(th.from_numpy(training["tensors"][name]))
    except LIBRARY_ERRORS as error:
        raise InputError(one_line(f"{file} contradicts its config: {error or type(error).__name__}")) from None


def _single_tensors(algorithm: BaseAlgorithm) -> dict[str, th.Tensor]:
    """The tensors outside the policy, by name; Stable-Baselines3 has no public function for them."""
    return {name: attrgetter(name)(algorithm) for name in algorithm._get_torch_save_params()[1]}


def _optimizer_state(optimizer: th.optim.Optimizer, saved: Mapping[str, Any]) -> dict[str, Any]:
    """The saved state and learning rates, with the other options of the present optimiser."""
    weights = [weight for group in optimizer.param_groups for weight in group["params"]]
    state = {int(index): _tensors(values) for index, values in saved["state"].items()}
    for index, values in state.items():
        if not set(map(np.shape, values.values())) <= {(), weights[index].shape}:  # torch does not check the shapes
            raise ValueError("the shapes of an optimiser's state and its weights differ")
    pairs = zip(optimizer.state_dict()["param_groups"], saved["param_groups"], strict=True)
    return {"state": state, "param_groups": [present | {"lr": float(old["lr"])} for present, old in pairs]}


def _tensors(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: th.from_numpy(value) if isinstance(value, np.ndarray) else value for name, value in values.items()}


def download(reference: str) -> Path:
    """Download the files of a reference, unless they are cached; return the local folder."""
    repository, revision = parse_reference(reference)
    hub = hub_library()
    with translate_errors(reference):
        # A single worker is used, because workers share a connection, and a worker that fails closes this connection.
        options = {"max_workers": 1, "allow_patterns": _DOWNLOADED_FILES}
        folder = Path(hub.snapshot_download(repository, revision=revision, **options))
    if not is_shared(folder) or not (folder / POLICY).is_file():
        raise InputError(f"{reference} is not a policy of tb2rl: it lacks {SHARED_CONFIG} or {POLICY}")
    return folder


def parse_reference(reference: str) -> tuple[str, str | None]:
    """Split a reference into repository and revision; None as revision means the newest."""
    match = _REFERENCE.fullmatch(reference)
    if match is None:
        raise InputError(f"a policy on the hub is hf:user/repository, got {one_line(reference, 100)}")
    return match[1], match[2]


def cached_reference(folder: Path) -> str | None:
    """The reference of a folder in the cache of huggingface_hub; None for any other folder."""
    match = re.fullmatch(r"models--(.+)--(.+)", folder.parent.parent.name)
    return f"{HUB}{match[1]}/{match[2]}" if match and folder.parent.name == "snapshots" else None


def hub_library() -> Any:
    """Import the module huggingface_hub."""
    try:
        import huggingface_hub.utils  # also imports the submodules `constants` and `errors`
    except ImportError:
        raise InputError(f"the hub needs the extra `hub`: {install_extra('hub')}") from None
    return huggingface_hub


@contextmanager
def translate_errors(reference: str) -> Iterator[None]:
    """Translate errors of huggingface_hub, except file errors, into one line.

    `from None` drops the request of an error, because it contains the user's token.
    """
    hub = hub_library()
    names = ("HfHubHTTPError", "HFValidationError", "LocalEntryNotFoundError", "LocalTokenNotFoundError")
    try:
        with _suppress_output(hub.utils):
            yield
    except tuple(getattr(hub.errors, name) for name in names) as error:
        raise InputError(one_line(f"{reference}: {error}")) from None
    except Exception as error:
        if isinstance(error, InputError) or (isinstance(error, OSError) and error.filename):  # a file of the cache
            raise
        problem = f"the hub at {hub.constants.ENDPOINT} cannot be reached ({type(error).__name__})"
        raise InputError(f"{reference}: {problem}") from None


@contextmanager
def _suppress_output(utils: Any) -> Iterator[None]:
    """Suppress the library's log messages, and its progress bars unless stderr is a terminal."""
    with ExitStack() as restore:
        restore.callback(utils.logging.set_verbosity, utils.logging.get_verbosity())
        utils.logging.set_verbosity(CRITICAL)
        if not sys.stderr.isatty() and not utils.are_progress_bars_disabled():
            restore.callback(utils.enable_progress_bars)
            utils.disable_progress_bars()
        yield

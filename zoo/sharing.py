"""Sharing a policy on the hub of Hugging Face: data alone, and a card with the hub's metadata.

What is uploaded is a run folder with its config as JSON, see `tb2rl.runs.folder`; `tb2rl.runs.hub` reads it.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from jinja2 import UndefinedError

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.core.files import read_text, write_text
from tb2rl.core.trust import untrusted_source
from tb2rl.envs.worlds import files_named
from tb2rl.evaluation.evaluation import kept_evaluation
from tb2rl.runs.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.runs.config import Config, config_from
from tb2rl.runs.folder import EVALUATION, EVALUATIONS, SHARED, Run
from tb2rl.runs.hub import HUB, POLICY, hub_library, parse_reference, translate_errors
from tb2rl.runs.loading import checkpoint_file
from tb2rl.zoo.building import PICTURE, draw
from tb2rl.zoo.cards import template

_SHARED_CONTENT = ("timesteps", "versions", "config", "policy", "normalisation")  # of a checkpoint: not how to go on


def run(options: argparse.Namespace) -> None:
    """Upload a policy, and say where it is."""
    if len(options.names) != 2:
        raise InputError(
            "push takes a policy of the zoo or a run folder, and the repository: push NAME user/repository"
        )
    name, repository = options.names
    for line in push(name, repository.removeprefix(HUB), options.private):
        print(line)


def push(name: str, repository: str, private: bool = False) -> list[str]:
    """Upload a policy; what was in the repository under the same names is replaced.

    Args:
        name: Of a policy of the zoo, with or without "zoo:", or a run folder.
        repository: "user/repository"; made if there is none.
        private: Whether a new repository is for its owner's eyes only.

    Returns:
        What there is to say, in sentences.

    Raises:
        InputError: If there is no such policy, it cannot be shared, or the hub does not take it.
    """
    reference = f"{HUB}{repository}"
    if parse_reference(reference)[1] is not None:
        raise InputError(f"push takes a repository without a revision, got {repository}")
    shared = Run.open(_folder(name))
    _check(shared)
    hub = hub_library()
    with TemporaryDirectory() as folder:
        stage(shared, repository, Path(folder))
        with translate_errors(reference, repository):
            api = hub.HfApi()
            api.create_repo(repository, private=private or None, exist_ok=True)
            api.upload_folder(repo_id=repository, folder_path=folder, commit_message=f"tb2rl {tb2rl.__version__}")
    said = [f"{reference} is on the hub; see it drive: python -m tb2rl.play {reference}"]
    try:
        with untrusted_source(reference):
            config_from(shared.config.to_dict())
    except InputError as error:
        said.append(f"others need the same modules, and --trust: {error}")
    return said


def _folder(name: str) -> Path:
    """The run folder of that path, else that of the policy of the zoo."""
    folder = Path(name)
    return folder if folder.is_dir() else checkpoint_file(f"zoo:{name.removeprefix('zoo:')}").parents[1]


def _check(shared: Run) -> None:
    """Raise an `InputError` for a policy that says nothing of how good it is, or that nobody else could load."""
    if not (shared.folder / EVALUATION).is_file():
        raise InputError(f"{shared.folder} has no standard evaluation: run `python -m tb2rl.evaluate {shared.folder}`")
    for file in files_named(shared.config.task.world):
        raise InputError(f"its world {file} is a file of this machine, so nobody else could load the policy")


def stage(shared: Run, repository: str, folder: Path) -> None:
    """Put what is uploaded of a run into an empty folder.

    Args:
        shared: The run, with its standard evaluation.
        repository: Where it is to go, "user/repository".
        folder: The folder.

    Raises:
        InputError: If the run's files are damaged.
    """
    content, figures = read_checkpoint(shared.policy_file), _figures(shared, repository)
    (folder / POLICY).parent.mkdir()
    write_checkpoint(folder / POLICY, {name: content[name] for name in _SHARED_CONTENT if name in content})
    said = {**content["config"], "versions": content["versions"]}  # config.yaml may say more steps, of a resumed run
    for name, tree in ((SHARED, said), (EVALUATION, figures)):
        write_text(folder / name, json.dumps(tree, indent=1) + "\n")
    for name in (EVALUATIONS, PICTURE):
        if (shared.folder / name).is_file():
            shutil.copy(shared.folder / name, folder / name)
    if shared.has_evaluation:
        draw(kept_evaluation(shared), folder / PICTURE)
    has_picture = (folder / PICTURE).is_file()
    try:
        write_text(folder / "README.md", card(shared.config, figures, repository, has_picture))
    except (LookupError, TypeError, ValueError, UndefinedError):
        raise InputError(f"{shared.folder / EVALUATION} is not a standard evaluation") from None


def _figures(shared: Run, repository: str) -> dict[str, Any]:
    """The standard evaluation, without where the policy was on this machine."""
    file = shared.folder / EVALUATION
    try:
        return {**json.loads(read_text(file)), "policy": f"{HUB}{repository}"}
    except (TypeError, ValueError, RecursionError):
        raise InputError(f"{file} is not a standard evaluation") from None


def card(config: Config, figures: Mapping[str, Any], repository: str, has_picture: bool) -> str:
    """The text of a shared policy's card, with the metadata that the hub reads.

    Args:
        config: What it was trained to do.
        figures: The standard evaluation, see `Evaluation.summary`.
        repository: "user/repository".
        has_picture: Whether there is a picture of its paths.
    """
    good = "success" if config.task.goal_task else "failure_free"
    metadata = _metadata(config, figures, repository, good)
    values = {"config": config, "figures": figures, "repository": repository, "good": good, "PICTURE": PICTURE}
    return template("shared.md.jinja").render(metadata=metadata, has_picture=has_picture, **values)


def _metadata(config: Config, figures: Mapping[str, Any], repository: str, good: str) -> str:
    """What the hub sorts and shows policies by, as YAML."""
    hub = hub_library()
    environment = environment_id(config)
    reward = f"{figures['mean_return']:.2f} +/- {figures['std_return']:.2f}"
    rate, called = figures[f"{good}_rate"], "success rate" if good == "success" else "crash-free rate"
    about = {"task_type": "reinforcement-learning", "task_name": "reinforcement-learning"}
    results = [
        hub.EvalResult(
            dataset_type=environment,
            dataset_name=environment,
            metric_type=kind,
            metric_value=value,
            metric_name=name,
            **about,
        )
        for kind, value, name in (("mean_reward", reward, "mean_reward"), (f"{good}_rate", rate, called))
    ]
    return hub.ModelCardData(
        library_name="tb2rl",
        pipeline_tag="reinforcement-learning",
        tags=["reinforcement-learning", "deep-reinforcement-learning", "tb2rl", "robotics", environment],
        model_name=repository.partition("/")[2],
        eval_results=results,
    ).to_yaml()


def environment_id(config: Config) -> str:
    """Gymnasium's id of what a policy was trained at, else the name of its task."""
    raw = config.observation == "raw"
    ids = {
        (arguments["task"], arguments.get("observation") == "raw"): name for name, arguments in tb2rl.GYM_IDS.items()
    }
    return ids.get((config.task_name, raw), config.task_name.rpartition(":")[2])

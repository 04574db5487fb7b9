"""Shares policies on the Hugging Face hub, without pickled code and with a model card.

An upload is a run folder with the config as JSON, see `tb2rl.runs.folder`. `tb2rl.runs.loading` has the download.
"""

import argparse
import json
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from jinja2 import UndefinedError

import tb2rl
from tb2rl.core import InputError, read_text, untrusted_source, write_text
from tb2rl.envs.worlds import paths_in
from tb2rl.evaluation.evaluation import load_evaluation
from tb2rl.evaluation.sim_to_sim import load_sim_to_sim
from tb2rl.runs import Config, checkpoint_file, config_from, read_checkpoint, write_checkpoint
from tb2rl.runs.folder import EVALUATION, SHARED_CONFIG, TRAINING_EVALUATIONS, Run
from tb2rl.runs.loading import HUB, POLICY, hub_library, parse_reference, translate_errors
from tb2rl.zoo.cards import template
from tb2rl.zoo.maintenance import PICTURE, draw

# Parts of a checkpoint that are uploaded; the state of the training is not.
_SHARED_CONTENT = ("timesteps", "versions", "config", "policy", "normalisation")


def push(options: argparse.Namespace) -> None:
    """Upload a policy to a new or existing repository on the hub, and print the address.

    Raises:
        InputError: If the policy does not exist or cannot be shared, or the hub rejects the upload.
    """
    repository = options.repository.removeprefix(HUB)
    reference = f"{HUB}{repository}"
    if parse_reference(reference)[1] is not None:
        raise InputError(f"{repository!r} has a revision; give the repository without a revision")
    run = _shareable_run(options.name)
    hub = hub_library()
    with TemporaryDirectory() as folder:
        prepare_upload(run, repository, Path(folder))
        with translate_errors(reference):
            api = hub.HfApi()
            api.create_repo(repository, private=options.private or None, exist_ok=True)  # None: the hub's default
            api.upload_folder(repo_id=repository, folder_path=folder, commit_message=f"tb2rl {tb2rl.__version__}")
    print(f"{reference} is on the hub; see it drive: python -m tb2rl.play {reference}")
    try:
        with untrusted_source(reference):
            config_from(run.config.to_dict())
    except InputError as error:
        print(f"others need the same modules and --trust: {error}")


def _shareable_run(name: str) -> Run:
    """Open the run folder `name`, or the run of the zoo's policy `name`.

    Raises:
        InputError: If the run has no standard evaluation, or its world is a file of the user.
    """
    path = Path(name)
    folder = path if path.is_dir() else checkpoint_file(f"zoo:{name.removeprefix('zoo:')}").parents[1]
    run = Run.open(folder)
    if not (folder / EVALUATION).is_file():
        raise InputError(f"{folder} has no standard evaluation: run `python -m tb2rl.evaluate {folder}`")
    for file in paths_in(run.config.task.world):
        raise InputError(f"others cannot load this policy, because its world {file} is a local file")
    return run


def prepare_upload(run: Run, repository: str, folder: Path) -> None:
    """Write the files of an upload to an empty folder.

    Args:
        run: A run with the summary of a standard evaluation; the episodes may be missing.
        repository: Destination, "user/repository".
        folder: The empty folder.

    Raises:
        InputError: If the run's files are damaged.
    """
    content, evaluation = read_checkpoint(run.policy_file), run.folder / EVALUATION
    picture = PICTURE if run.has_evaluation_episodes or (run.folder / PICTURE).is_file() else None
    try:
        summary = {**json.loads(read_text(evaluation)), "policy": f"{HUB}{repository}"}  # no local path
        values = {"config": run.config, "summary": summary, "repository": repository, "picture": picture}
        values["sim_to_sim"] = load_sim_to_sim(run)
        text = template("shared.md.jinja").render(values, environment=_environment_id(run.config))
    except (LookupError, RecursionError, TypeError, ValueError, UndefinedError):
        raise InputError(f"{evaluation} is not a standard evaluation") from None
    write_text(folder / "README.md", text)
    (folder / POLICY).parent.mkdir()
    write_checkpoint(folder / POLICY, {name: content[name] for name in _SHARED_CONTENT if name in content})
    # Not the config of config.yaml, which has more steps if the run was resumed after this checkpoint.
    config = {**content["config"], "versions": content["versions"]}
    for name, tree in ((SHARED_CONFIG, config), (EVALUATION, summary)):
        write_text(folder / name, json.dumps(tree, indent=1) + "\n")
    for name in (TRAINING_EVALUATIONS, PICTURE):
        if (run.folder / name).is_file():
            shutil.copy(run.folder / name, folder / name)
    if run.has_evaluation_episodes:  # else the copy remains: the zoo's entries lack episodes
        draw(load_evaluation(run), folder / PICTURE)


def _environment_id(config: Config) -> str:
    """Gymnasium id of the environment of a config; the name of the task if there is no id."""
    for name, arguments in tb2rl.GYM_IDS.items():
        if (arguments["task"], arguments.get("observation", "discrete")) == (config.task_name, config.observation):
            return name
    return config.task_name.rpartition(":")[2]

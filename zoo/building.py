"""Builds entries of the zoo: trains policies by their recipes, then evaluates the policies in unseen worlds."""

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image

from tb2rl.commands.train import train_and_evaluate
from tb2rl.core.files import write_text
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluation import Evaluation, load_evaluation
from tb2rl.execution.executor import Executor
from tb2rl.execution.job import Job, read_files, write_files
from tb2rl.runs.folder import EVALUATION, EVALUATIONS, Run
from tb2rl.training.training import default_folder
from tb2rl.viz.pictures import draw_paths
from tb2rl.zoo.entry import UNSEEN_WORLDS, WORLDS, Entry

_NUM_DRAWN = 30  # number of first episodes in a picture; later episodes are drawn only if they failed
PICTURE = "paths.png"


def train(entries: Sequence[Entry], again: bool, executor: Executor) -> None:
    """Train and evaluate policies, and add each to the zoo as soon as it is trained.

    Args:
        entries: Entries to train.
        again: Whether to train entries again that match their recipes.
        executor: Runs the trainings.
    """
    to_train = {entry.name: entry for entry in entries if again or not entry.matches_recipe}
    jobs = []
    for name, entry in to_train.items():
        config = entry.recipe_config
        folder = default_folder(config).with_name(f"{name}-{datetime.now():%Y%m%d-%H%M%S}")
        jobs.append(Job(name, (config, str(folder), 0), folder))
    for job, _ in executor.as_completed(train_and_evaluate, jobs, shared=[{}]):
        assert job.folder is not None
        run, entry = Run.open(job.folder), to_train[job.name]
        draw(load_evaluation(run), job.folder / PICTURE)
        files = {name: (run.folder / name).read_bytes() for name in ("config.yaml", EVALUATIONS, EVALUATION, PICTURE)}
        files[f"best/{run.policy_file.name}"] = run.policy_file.read_bytes()
        write_files(files, entry.folder)
        print(f"{job.name}: trained in {job.folder}", flush=True)


def evaluate_in_unseen_worlds(entries: Sequence[Entry], executor: Executor) -> None:
    """Evaluate policies in their missing unseen worlds, and write the summaries to their folders."""
    missing = {f"{entry.name} in {world}": (entry, world) for entry in entries for world in entry.missing_worlds}
    jobs = [Job(name, (read_files(entry.folder), world)) for name, (entry, world) in missing.items()]
    for job, summary in executor.as_completed(_evaluate_in_world, jobs):
        entry, world = missing[job.name]
        entry.unseen_worlds[world] = summary
        in_order = {name: entry.unseen_worlds[name] for name in WORLDS if name in entry.unseen_worlds}
        write_text(entry.folder / UNSEEN_WORLDS, json.dumps(in_order, indent=1) + "\n")
        print(job.name, flush=True)


def _evaluate_in_world(files: Mapping[str, bytes], world: str) -> dict[str, Any]:
    """Summary of the standard evaluation in a world; `files` is the content of an entry's folder."""
    with TemporaryDirectory() as parent:
        folder = Path(parent, "entry")
        write_files(files, folder)
        return evaluate(folder, settings={"world": world}).summary()


def draw(evaluation: Evaluation, file: Path) -> None:
    """Draw the paths of the first episodes and of all failed ones."""
    drawn_episodes = [episode for i, episode in enumerate(evaluation.episodes) if episode.failed or i < _NUM_DRAWN]
    picture = draw_paths(evaluation.scene, drawn_episodes)
    Image.fromarray(picture).quantize(64).save(file, optimize=True)

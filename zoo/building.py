"""Making an entry of the zoo: trained as its recipe says, then driven in worlds that it never saw."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image

from tb2rl.commands.seeds import train_and_evaluate
from tb2rl.core.files import read_text, write_text
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.evaluation import Evaluation, kept_evaluation
from tb2rl.execution.executor import Executor
from tb2rl.execution.job import Job, read_files, write_files
from tb2rl.runs.folder import EVALUATION, EVALUATIONS, Run
from tb2rl.training.training import default_folder
from tb2rl.viz.pictures import draw_paths
from tb2rl.zoo.entry import ELSEWHERE, WORLDS, Entry

_DRAWN = 30  # episodes in a picture, and all that failed
PICTURE = "paths.png"


def build(chosen: Sequence[Entry], again: bool, executor: Executor) -> None:
    """Train and evaluate policies, as far as they are not there yet; each is in the zoo once it is done.

    Args:
        chosen: Which.
        again: Whether to train those that are there, too.
        executor: Runs the trainings and evaluations.
    """
    wanted = [entry for entry in chosen if again or not _is_trained(entry)]
    by_name = {entry.name: entry for entry in wanted}
    for job, _ in executor.as_completed(train_and_evaluate, [_training(entry) for entry in wanted], shared=[{}]):
        assert job.folder is not None
        draw(kept_evaluation(Run.open(job.folder)), job.folder / PICTURE)
        _take_over(job.folder, by_name[job.name].folder)
        print(f"{job.name}: trained in {job.folder}", flush=True)
    anew = [Entry(entry.name, entry.recipe, entry.folder) for entry in chosen]  # read again, for they may be others now
    places = {f"{entry.name} in {world}": (entry, world) for entry in anew for world in entry.not_driven}
    jobs = [Job(name, (read_files(entry.folder), world)) for name, (entry, world) in places.items()]
    for job, figures in executor.as_completed(_figures_in, jobs):
        entry, world = places[job.name]
        _add(figures, world, entry.folder)
        print(job.name, flush=True)


def _is_trained(entry: Entry) -> bool:
    return (entry.folder / "config.yaml").is_file() and entry.is_as_requested


def _training(entry: Entry) -> Job:
    config = entry.requested
    folder = default_folder(config).with_name(f"{entry.name}-{datetime.now():%Y%m%d-%H%M%S}")
    return Job(entry.name, (config, str(folder), 0), folder)


def draw(evaluation: Evaluation, file: Path) -> None:
    """Draw the paths of the first episodes and of all that failed."""
    shown = [episode for i, episode in enumerate(evaluation.episodes) if episode.failed or i < _DRAWN]
    picture = draw_paths(evaluation.scene, shown)
    Image.fromarray(picture).quantize(64).save(file, optimize=True)


def _take_over(folder: Path, place: Path) -> None:
    """Put what others need of a run folder into the zoo, in the place of what is there."""
    staging, old = place.with_name(f".{place.name}.new"), place.with_name(f".{place.name}.old")
    shutil.rmtree(staging, ignore_errors=True)
    (staging / "best").mkdir(parents=True)
    for name in ("config.yaml", EVALUATIONS, EVALUATION, PICTURE):
        shutil.copy(folder / name, staging / name)
    policy = Run.open(folder).policy_file
    shutil.copy(policy, staging / "best" / policy.name)
    if place.exists():
        shutil.rmtree(old, ignore_errors=True)
        place.rename(old)
    staging.rename(place)
    shutil.rmtree(old, ignore_errors=True)


def _figures_in(files: Mapping[str, bytes], world: str) -> dict[str, Any]:
    """The figures of the standard evaluation of an entry in a world."""
    with TemporaryDirectory() as parent:
        folder = Path(parent, "entry")
        write_files(files, folder)
        return evaluate(folder, settings={"world": world}).summary()


def _add(summary: Mapping[str, Any], world: str, folder: Path) -> None:
    """Put figures in a world to those that an entry's folder has."""
    file = folder / ELSEWHERE
    figures = json.loads(read_text(file)) if file.is_file() else {}
    figures[world] = summary
    in_order = {name: figures[name] for name in WORLDS if name in figures}
    write_text(file, json.dumps(in_order, indent=1) + "\n")

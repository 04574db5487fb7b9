"""Making an entry of the zoo: trained as its recipe says, then driven in worlds that it never saw."""

from __future__ import annotations

import json
import shlex
import shutil
from datetime import datetime
from pathlib import Path
from typing import Any

from PIL import Image

from tb2rl.errors import InputError
from tb2rl.files import write_text
from tb2rl.judging.evaluation import Evaluation, kept_evaluation
from tb2rl.judging.evaluator import evaluate
from tb2rl.learning.training import default_folder
from tb2rl.runs.folder import EVALUATION, EVALUATIONS, Run
from tb2rl.showing.pictures import draw_paths
from tb2rl.train import main as train
from tb2rl.zoo.entry import CLOSED_MAZES, ELSEWHERE, Entry

_DRAWN = 30  # episodes in a picture, and all that failed
_PICTURE = "paths.png"


def build(entry: Entry, again: bool) -> None:
    """Train and evaluate a policy, as far as it is not there yet.

    Raises:
        InputError: If the training was interrupted, so that it has no evaluation.
    """
    if again or not (entry.folder / "config.yaml").is_file() or not entry.is_as_requested:
        folder = default_folder(entry.requested).with_name(f"{entry.name}-{datetime.now():%Y%m%d-%H%M%S}")
        train([*shlex.split(entry.recipe), "--name", folder.name])
        _draw(kept_evaluation(Run.open(folder)), folder / _PICTURE)
        _take_over(folder, entry.folder)
    if not entry.is_built:
        write_text(entry.folder / ELSEWHERE, json.dumps(_drive_elsewhere(entry), indent=1) + "\n")


def _draw(evaluation: Evaluation, file: Path) -> None:
    """Draw the paths of the first episodes and of all that failed."""
    shown = [episode for i, episode in enumerate(evaluation.episodes) if episode.failed or i < _DRAWN]
    columns = ([getattr(each, name) for each in shown] for name in ("path", "failed", "world"))
    picture = draw_paths(evaluation.scene, *columns)
    Image.fromarray(picture).quantize(64).save(file, optimize=True)


def _take_over(folder: Path, place: Path) -> None:
    """Put what others need of a run folder into the zoo, in the place of what is there."""
    staging, old = place.with_name(f".{place.name}.new"), place.with_name(f".{place.name}.old")
    shutil.rmtree(staging, ignore_errors=True)
    (staging / "best").mkdir(parents=True)
    for name in ("config.yaml", EVALUATIONS, EVALUATION, _PICTURE):
        shutil.copy(folder / name, staging / name)
    policy = Run.open(folder).policy_file
    shutil.copy(policy, staging / "best" / policy.name)
    if place.exists():
        shutil.rmtree(old, ignore_errors=True)
        place.rename(old)
    staging.rename(place)
    shutil.rmtree(old, ignore_errors=True)


def _drive_elsewhere(entry: Entry) -> dict[str, dict[str, Any]]:
    """The figures of the standard evaluation in each closed maze that it never saw, and can drive in."""
    figures = {}
    for name in CLOSED_MAZES:
        if name != entry.world and _fits(entry, name):
            print(f"{entry.name} in {name}", flush=True)
            figures[name] = evaluate(entry.folder, settings={"world": name}, progress=True).summary()
    return figures


def _fits(entry: Entry, world: str) -> bool:
    """Whether the task can be set in a world: one that has a goal, if the task needs it."""
    try:
        entry.config.with_task({"world": world})
    except InputError:
        return False
    return True

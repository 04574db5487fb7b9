"""Making an entry of the zoo: trained as its recipe says, then driven in worlds that it never saw."""

from __future__ import annotations

import json
import shlex
import shutil
from datetime import datetime
from pathlib import Path

from PIL import Image

from tb2rl.files import read_text, write_text
from tb2rl.judging.evaluation import Evaluation, kept_evaluation
from tb2rl.judging.evaluator import evaluate
from tb2rl.learning.training import default_folder
from tb2rl.runs.folder import EVALUATION, EVALUATIONS, Run
from tb2rl.showing.pictures import draw_paths
from tb2rl.train import main as train
from tb2rl.zoo.entry import ELSEWHERE, WORLDS, Entry

_DRAWN = 30  # episodes in a picture, and all that failed
PICTURE = "paths.png"


def build(entry: Entry, again: bool) -> None:
    """Train and evaluate a policy, as far as it is not there yet.

    Raises:
        InputError: If the training was interrupted, so that it has no evaluation.
    """
    if again or not (entry.folder / "config.yaml").is_file() or not entry.is_as_requested:
        folder = default_folder(entry.requested).with_name(f"{entry.name}-{datetime.now():%Y%m%d-%H%M%S}")
        train([*shlex.split(entry.recipe), "--name", folder.name])
        draw(kept_evaluation(Run.open(folder)), folder / PICTURE)
        _take_over(folder, entry.folder)
    for world in Entry(entry.name, entry.recipe, entry.folder).not_driven:  # read anew, for it may be another now
        print(f"{entry.name} in {world}", flush=True)
        _drive_in(world, entry.folder)


def draw(evaluation: Evaluation, file: Path) -> None:
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
    for name in ("config.yaml", EVALUATIONS, EVALUATION, PICTURE):
        shutil.copy(folder / name, staging / name)
    policy = Run.open(folder).policy_file
    shutil.copy(policy, staging / "best" / policy.name)
    if place.exists():
        shutil.rmtree(old, ignore_errors=True)
        place.rename(old)
    staging.rename(place)
    shutil.rmtree(old, ignore_errors=True)


def _drive_in(world: str, folder: Path) -> None:
    """Add the figures of the standard evaluation in a world to those that an entry's folder has."""
    file = folder / ELSEWHERE
    figures = json.loads(read_text(file)) if file.is_file() else {}
    figures[world] = evaluate(folder, settings={"world": world}, progress=True).summary()
    in_order = {name: figures[name] for name in WORLDS if name in figures}
    write_text(file, json.dumps(in_order, indent=1) + "\n")

"""Keeps the zoo: trains its policies, judges them, writes their cards and the table, checks that these hold.

    python -m tb2rl.zoo build                          # what is not there yet as its recipe says, all cards, the table
    python -m tb2rl.zoo build maze-loop-dqn --again    # from scratch
    python -m tb2rl.zoo check [NAME ...]

`recipes.yaml` holds the recipes: for each policy the arguments of `python -m tb2rl.train`. It is trained in `runs`, as
any other; what the zoo takes of the run folder gets a card (README.md), a picture of its paths, and what it does in
mazes that it never saw (elsewhere.json). `check` judges policies in their own mazes again.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from PIL import Image

from tb2rl.config import Config
from tb2rl.errors import ArgumentParser, InputError, command, one_line, unknown
from tb2rl.evaluation import EPISODES, Evaluation, evaluate, kept, wilson_interval
from tb2rl.maze import load_maze
from tb2rl.observations import prepare
from tb2rl.render import draw_paths
from tb2rl.runs import Run, write
from tb2rl.settings import read_text, read_yaml, room
from tb2rl.train import main as train
from tb2rl.train import parse as parse_training
from tb2rl.train import requested
from tb2rl.training import default_folder

CLOSED_MAZES = ("loop", "circuit", "round", "maze")  # around `wall` is open floor: a robot that drives away is safe
PROMISED, PROMISED_TABULAR = 0.99, 0.95  # share of good episodes
GOOD_SPEED = 0.75  # of the fastest command: no driver is faster
_DRAWN, _STARTS_NAMED = 30, 5  # episodes in a picture, failed ones on a card
_TOLERANCE = 0.02  # of the speed, from one machine to another


@dataclass(frozen=True)
class Entry:
    """One policy of the zoo; what it reads of its folder is there once it is built."""

    name: str
    recipe: str  # arguments of `python -m tb2rl.train`
    folder: Path

    @cached_property
    def config(self) -> Config:
        return Run.open(self.folder).config

    @property
    def requested(self) -> Config:
        """What the recipe asks for."""
        return requested(parse_training(shlex.split(self.recipe)))

    @cached_property
    def figures(self) -> dict[str, Any]:
        """The standard evaluation, see `Evaluation.summary`, and every episode of it as `each`."""
        return _read(self.folder / "evaluation.json")[0]

    @cached_property
    def elsewhere(self) -> dict[str, dict[str, Any]]:
        """The same figures in each maze that it never saw."""
        return _read(self.folder / "elsewhere.json")[0]

    @cached_property
    def notes(self) -> list[dict[str, Any]]:
        """The evaluations while training."""
        return _read(self.folder / "evaluations.jsonl", lines=True)

    @property
    def maze(self) -> str:
        return self.config.task_settings.maze

    @property
    def beams(self) -> int:
        return len(prepare(self.config.task_settings, self.config.observation)[3].angles)

    @property
    def good(self) -> str:
        """Which rate counts the good episodes."""
        return "success" if self.config.task_settings.goal_task else "crash_free"

    @property
    def good_rate(self) -> float:
        return self.figures[f"{self.good}_rate"]

    @property
    def promised(self) -> float:
        """The share of good episodes that the zoo promises."""
        return PROMISED_TABULAR if self.config.observation == "discrete" else PROMISED

    @property
    def promised_speed(self) -> float:
        """The share of the fastest command's speed that the zoo promises; 0 where the way to the goal decides."""
        return 0.0 if self.good == "success" else GOOD_SPEED

    @property
    def speed_share(self) -> float:
        """Mean speed over that of the fastest command, which no driver can exceed."""
        return self.figures["mean_speed"] / float(np.abs(self.config.task_settings.commands[:, 0]).max())

    @property
    def trained(self) -> int:
        """Training steps."""
        return self.notes[-1]["timesteps"]

    @property
    def kept_after(self) -> int:
        """Training steps of the policy that was kept."""
        return next(note["timesteps"] for note in reversed(self.notes) if note["best"])


def _read(file: Path, lines: bool = False) -> list[Any]:
    """The JSON in a file, or in each line of it."""
    text = read_text(file)
    try:
        return [json.loads(part) for part in (text.splitlines() if lines else [text])]
    except ValueError as error:
        raise InputError(one_line(f"{file} is not JSON: {error}")) from None


def entries(names: Sequence[str] = ()) -> list[Entry]:
    """The policies of these names; without names all.

    Raises:
        InputError: For a name that has no recipe.
    """
    recipes = read_yaml(room("zoo") / "recipes.yaml")
    for name in names:
        if name not in recipes:
            raise unknown("zoo policy", name, recipes)
    return [Entry(name, recipes[name], room("zoo") / name) for name in names or recipes]


def build(entry: Entry, again: bool) -> None:
    """Train and judge a policy, as far as it is not there yet.

    Raises:
        InputError: If the training was interrupted: it has no evaluation.
    """
    there = (entry.folder / "config.yaml").is_file()
    if again or not there or entry.config.to_dict() != entry.requested.to_dict():
        folder = default_folder(entry.requested).with_name(f"{entry.name}-{datetime.now():%Y%m%d-%H%M%S}")
        train([*shlex.split(entry.recipe), "--name", folder.name, "--no-progress"])
        _draw(kept(folder), folder / "paths.png")
        _take_over(folder, entry.folder)
    if not (entry.folder / "elsewhere.json").is_file():
        write(entry.folder / "elsewhere.json", json.dumps(_drive_elsewhere(entry), indent=1) + "\n")


def _draw(evaluation: Evaluation, file: Path) -> None:
    maze = load_maze(evaluation.task.maze)
    crashed = [episode.ended == "crash" for episode in evaluation.episodes]
    shown = [i for i, crash in enumerate(crashed) if crash or i < _DRAWN]
    picture = draw_paths(
        maze, evaluation.task.placed(maze), [evaluation.episodes[i].path for i in shown], [crashed[i] for i in shown]
    )
    Image.fromarray(picture).quantize(64).save(file, optimize=True)


def _take_over(folder: Path, place: Path) -> None:
    """Put what others need of a run folder into the zoo, in the place of what is there."""
    staging, old = place.with_name(f".{place.name}.new"), place.with_name(f".{place.name}.old")
    shutil.rmtree(staging, ignore_errors=True)
    (staging / "best").mkdir(parents=True)
    for name in ("config.yaml", "evaluations.jsonl", "evaluation.json", "paths.png"):
        shutil.copy(folder / name, staging / name)
    policy = Run.open(folder).policy_file
    shutil.copy(policy, staging / "best" / policy.name)
    if place.exists():
        shutil.rmtree(old, ignore_errors=True)
        place.rename(old)
    staging.rename(place)
    shutil.rmtree(old, ignore_errors=True)


def _drive_elsewhere(entry: Entry) -> dict[str, dict[str, Any]]:
    figures = {}
    for name in CLOSED_MAZES:
        if name != entry.maze and (load_maze(name).goal or not entry.config.task_settings.goal_task):
            print(f"{entry.name} in {name}", flush=True)
            figures[name] = evaluate(entry.folder, settings={"maze": name}).summary()
    return figures


def card(entry: Entry) -> str:
    """The text of a policy's card."""
    return _template("card.md").render(entry=entry, shortfalls=_shortfalls(entry), failures=_failures(entry))


def table(built: Sequence[Entry]) -> str:
    """The text of the zoo's README: the results of all policies, and how they do in each other's mazes."""
    return _template("zoo.md").render(entries=built, mazes=CLOSED_MAZES)


def overview(built: Sequence[Entry]) -> str:
    """The table of the project's README: a row for each task and maze, a column for each agent."""
    agents = list(dict.fromkeys(entry.config.agent for entry in built))
    lines = ["| task, maze | " + " | ".join(f"`{agent}`" for agent in agents) + " |", "|---" * (len(agents) + 1) + "|"]
    for place, there in groupby(built, key=lambda entry: (entry.config.task, entry.maze)):
        cells = {
            entry.config.agent: f"{_percent(entry.good_rate)}, {entry.figures['mean_speed']:.2f} m/s" for entry in there
        }
        lines.append("| " + " | ".join([f"`{', '.join(place)}`", *(cells.get(agent, "") for agent in agents)]) + " |")
    return "\n".join(lines) + "\n"


def _template(name: str) -> jinja2.Template:
    env = jinja2.Environment(
        loader=jinja2.PackageLoader("tb2rl", "assets"), trim_blocks=True, undefined=jinja2.StrictUndefined
    )
    env.filters.update(percent=_percent, interval=_interval, spaced=lambda number: f"{number:,}".replace(",", " "))
    return env.get_template(name)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _interval(ends: Sequence[float]) -> str:
    return f"{100 * ends[0]:.1f} to {100 * ends[1]:.1f} %"


def _shortfalls(entry: Entry) -> list[str]:
    speed, lines = entry.speed_share, []
    if entry.good_rate < entry.promised:
        lines.append(
            f"{_percent(entry.good_rate)} of its episodes are good, the zoo promises {_percent(entry.promised)}."
        )
    if speed < entry.promised_speed:
        promised = _percent(entry.promised_speed)
        lines.append(f"it drives at {_percent(speed)} of the fastest command's speed, the zoo promises {promised}.")
    return lines


def _failures(entry: Entry) -> list[str]:
    failed = [episode for episode in entry.figures["each"] if not episode["success"]]
    lines = [f"In its own maze: {len(failed)} of {entry.figures['episodes']} episodes."]
    for episode in failed[:_STARTS_NAMED]:
        x, y, yaw = episode["start"]
        lines.append(f"{episode['ended']} after {episode['length']} steps from ({x:.2f} m, {y:.2f} m, {yaw:.2f} rad)")
    for maze, figures in entry.elsewhere.items():
        endings = ", ".join(f"{ended} {count}" for ended, count in figures["endings"].items())
        failing, speed = _percent(1 - figures[f"{entry.good}_rate"]), figures["mean_speed"]
        lines.append(f"In `{maze}`, which it never saw: {failing} of the episodes ({endings}), at {speed:.2f} m/s.")
    return lines


def check(entry: Entry, episodes: int) -> list[str]:
    """Judge a policy again in its own maze; what its card and the new figures do not agree on."""
    again = evaluate(entry.folder, episodes=episodes)
    rate, speed = again.summary()[f"{entry.good}_rate"], again.summary()["mean_speed"]
    print(f"{entry.name}: {_percent(rate)} good episodes, {speed:.3f} m/s", flush=True)
    before = entry.figures["each"][:episodes]  # from the same start poses
    good = [each["success"] if entry.good == "success" else each["ended"] != "crash" for each in before]
    lowest, _ = wilson_interval(sum(good), len(good))
    seconds = sum(each["length"] for each in before) * entry.config.task_settings.control_period
    speed_before = sum(each["distance"] for each in before) / seconds
    wrong = []
    if entry.config.to_dict() != entry.requested.to_dict():
        wrong.append("it was not trained as its recipe says")
    if read_text(entry.folder / "README.md") != card(entry):
        wrong.append("its card is not what its files say")
    if rate < lowest:
        wrong.append(f"{_percent(rate)} good episodes, below the card's interval from {100 * lowest:.1f} %")
    if speed < (1 - _TOLERANCE) * speed_before:
        wrong.append(f"{speed:.3f} m/s, {speed_before:.3f} when the card was written")
    return [f"{entry.name}: {line}" for line in wrong]


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = ArgumentParser(prog="python -m tb2rl.zoo", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=("build", "check"))
    parser.add_argument("names", nargs="*", metavar="NAME", help="policies (default: all)")
    parser.add_argument("--again", action="store_true", help="build: train from scratch what is there, too")
    parser.add_argument("--episodes", type=int, default=EPISODES, help="check: of the standard evaluation, the first")
    return parser.parse_args(arguments)


@command
def main(arguments: list[str] | None = None) -> None:
    """Build the zoo or check it; status 1 if a card does not hold."""
    options = parse(arguments)
    chosen = entries(options.names)
    if options.what == "build":
        if not os.access(room("zoo"), os.W_OK):
            raise InputError(f"the zoo's folder {room('zoo')} is not writable")
        for entry in chosen:
            build(entry, options.again)
        there = [entry for entry in entries() if (entry.folder / "elsewhere.json").is_file()]
        for entry in there:
            write(entry.folder / "README.md", card(entry))
        write(room("zoo") / "README.md", table(there))
        return
    if not 1 <= options.episodes <= EPISODES:
        raise InputError(f"--episodes must be from 1 to {EPISODES}, got {options.episodes}")
    wrong = 0
    for entry in chosen:
        for line in check(entry, options.episodes):
            print(line, flush=True)
            wrong += 1
    if not options.names and read_text(room("zoo") / "README.md") != table(chosen):
        print("the table in README.md is not what the files say")
        wrong += 1
    if wrong:
        raise SystemExit(1)
    print(f"{len(chosen)} cards hold")


if __name__ == "__main__":
    main()

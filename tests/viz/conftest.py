"""Policies, tasks and runs to show, and what tests ask films and pages."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest
import yaml
from PIL import Image, ImageColor, ImageSequence

from tb2rl import report, train
from tb2rl.envs.scene import Scene, make_scene
from tb2rl.evaluation.episodes import Episode
from tb2rl.evaluation.evaluate import SEED, evaluate
from tb2rl.evaluation.evaluation import Evaluation
from tb2rl.runs.config import Config, resolve
from tb2rl.runs.folder import Run
from tb2rl.tasks import Outcome, Task, Velocities
from tb2rl.tasks.wander import Wander
from tb2rl.viz import run_views
from tb2rl.viz.cameras import FilmFrame, film_frames
from tb2rl.viz.film import FilmOptions, open_episodes
from tb2rl.viz.run_views import RunView, read_run_view

LINKS = {"src", "href", "xlink:href", "data", "action", "poster", "srcset"}


class _Constant:
    """A policy that always takes the same action; of named ones by default the first: forward."""

    def __init__(self, action: object = 0) -> None:
        self.action = np.array(action)

    def predict(self, observation, *, deterministic=False):
        return self.action, None


@dataclass(frozen=True)
class Cruise(Task):
    """Velocities; an episode in the upper half of the world fails."""

    actions = Velocities(forward=(0.0, 0.5), turn=(-1.0, 1.0))

    def outcome(self, before, action, after):
        return Outcome(2 * after.twist[:, 0], failed={"bump": after.bumped, "strayed": after.pose[:, 1] > 0.0})


def _config(task: str | type[Task] = "maze", **settings) -> Config:
    """The config of the agent `random`; settings are those of the task."""
    return resolve("random", task, settings={f"task.{key}": value for key, value in settings.items()})


def _frames_of(policy, config: Config, steps: int = 1, rate: float = 10) -> tuple[list[FilmFrame], Scene]:
    """The frames of one episode, and its scene."""
    with open_episodes(policy, config, None, FilmOptions(steps=steps), "filming") as (scene, episodes):
        (steps,) = map(list, episodes)
    return list(film_frames(steps, scene.task.control_period, rate)), scene


def _coloured(picture: np.ndarray, colour: str) -> np.ndarray:
    """Row and column of all pixels with a colour, up to the smoothing of edges, shape (pixels, 2)."""
    return np.argwhere(np.abs(picture.astype(int) - ImageColor.getrgb(colour)).max(axis=2) < 12)


def _green(picture: np.ndarray) -> np.ndarray:
    """Row and column of all green pixels, as goals are in any light, shape (pixels, 2)."""
    red, green, blue = np.moveaxis(picture.astype(int), 2, 0)
    return np.argwhere((green - red > 30) & (green - blue > 30))


def _read_film(path: Path) -> tuple[list[np.ndarray], float]:
    """The pictures of a film, each (height, width, 3), and its duration [s]."""
    if path.suffix == ".mp4":
        with av.open(str(path)) as container:
            return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)], container.duration / 1e6
    with Image.open(path) as image:
        frames = [(np.asarray(frame.convert("RGB")), frame.info["duration"]) for frame in ImageSequence.Iterator(image)]
    return [picture for picture, _ in frames], sum(duration for _, duration in frames) / 1000


def _episode(path, actions, ended="time limit", failed=None) -> Episode:
    """An episode along a path (steps + 1, 2); a collision fails, other endings as `failed` says."""
    path, actions = np.asarray(path, dtype=np.float32), np.asarray(actions)
    actions = actions.astype(np.uint8 if actions.ndim == 1 else np.float32)
    failed = ended == "collision" if failed is None else failed
    return Episode((0.0, 0.0, 0.0), ended, failed, ended == "goal", False, len(actions), 123.4, 5.0, path, actions)


def _evaluation(episodes: list[Episode], task: Task | None = None, **settings) -> Evaluation:
    """An evaluation of made-up episodes, at `maze` unless a task is given."""
    return Evaluation(episodes, make_scene(task or Wander(**settings), "discrete"), SEED, "kinematic")


def _store_evaluation(folder: Path, episodes: int, steps: int, ended: str) -> None:
    """Store an evaluation of random paths in a run folder."""
    config, rng = Run.open(folder).config, np.random.default_rng(0)
    x0, y0, x1, y1 = config.scene.world.bounds
    paths = rng.uniform((x0, y0), (x1, y1), (episodes, steps + 1, 2))
    each = [_episode(path, rng.integers(3, size=steps), ended) for path in paths]
    evaluation = Evaluation(each, config.scene.with_time_limit(steps), SEED, "kinematic")
    Run.open(folder).write_evaluation(*evaluation.serialize(config, str(folder)))


def _copied(run: Path, folder: Path, part: str = "train", **settings) -> Path:
    """A copy of a run folder with other settings in a part of its config."""
    shutil.copytree(run, folder)
    tree = yaml.safe_load((folder / "config.yaml").read_text())
    tree[part].update(settings)
    (folder / "config.yaml").write_text(yaml.safe_dump(tree))
    return folder


class _Page(HTMLParser):
    """The text and the elements of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.source, self.words = text, []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)
        self.text = " ".join("".join(self.words).split())
        self.ids = [attributes["id"] for _, attributes in self.elements if attributes.get("id")]

    @classmethod
    def of(cls, *references: Path, out: Path) -> _Page:
        """The page that the command `report` writes."""
        report.main([*map(str, references), "--out", str(out)])
        return cls(out.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes) -> None:
        self.elements.append((tag, dict(attributes)))

    def handle_data(self, data) -> None:
        self.words.append(data)

    @property
    def links(self) -> list[str]:
        """Its references: within itself ("#..."), embedded ("data:..."), or elsewhere."""
        links = [value or "" for _, attributes in self.elements for key, value in attributes.items() if key in LINKS]
        return links + re.findall(r"(?:url\(|@import\s*)([^;)]*)", self.source)

    def count(self, tag: str) -> int:
        return sum(element == tag for element, _ in self.elements)


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    """The functions above that make something."""
    made = {"config": _config, "policy": _Constant, "frames": _frames_of, "copied": _copied}
    return SimpleNamespace(**made, episode=_episode, evaluation=_evaluation)


@pytest.fixture(scope="session")
def read_film():
    return _read_film


@pytest.fixture(scope="session")
def coloured():
    return _coloured


@pytest.fixture(scope="session")
def green():
    return _green


@pytest.fixture(scope="session")
def pages() -> type[_Page]:
    return _Page


@pytest.fixture(scope="session")
def cruise() -> type[Task]:
    return Cruise


@pytest.fixture
def short_evaluations(monkeypatch) -> None:
    """Evaluations that are made for a page: one short episode."""
    short = partial(evaluate, steps=20, simulation="kinematic")
    monkeypatch.setattr(run_views, "evaluate", lambda policy, episodes, progress_bar: short(policy, episodes=1))


@pytest.fixture(scope="session")
def seeds(tmp_path_factory) -> Path:
    """A folder of runs of two seeds, as `train --seeds` writes it; read-only."""
    folder = tmp_path_factory.mktemp("runs") / "seeds"
    quick = {"simulation": "kinematic", "n_envs": 8, "eval_episodes": 2, "eval_steps": 20, "save_freq": 0}
    for seed in (0, 1):
        run = folder / f"seed-{seed}"
        train("qlearn", total_timesteps=24_000, eval_freq=12_000, seed=seed, folder=run, **quick)
        _store_evaluation(run, episodes=3, steps=50, ended="collision")
    return folder


@pytest.fixture(scope="session")
def views(seeds) -> list[RunView]:
    """Both runs as a page shows them; read-only."""
    return [read_run_view(seeds / name, name) for name in ("seed-0", "seed-1")]


@pytest.fixture(scope="session")
def goal_run(tmp_path_factory) -> Path:
    """A run of a network at a task with a goal, without evaluations; read-only."""
    folder = tmp_path_factory.mktemp("runs") / "goal"
    quick = {"simulation": "kinematic", "n_envs": 8, "save_freq": 0}
    train("dqn", task="wall", total_timesteps=8, eval_freq=0, folder=folder, **quick)
    return folder

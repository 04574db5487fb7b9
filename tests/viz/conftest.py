"""Policies, tasks and runs to show, and what tests ask films and pages."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest
import yaml
from PIL import Image

from tb2rl import report, train
from tb2rl.envs.scene import make_scene
from tb2rl.evaluation.evaluation import Episode, Evaluation
from tb2rl.evaluation.evaluator import SEED
from tb2rl.runs.config import Config
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.tasks import Outcome, Task, Velocities
from tb2rl.tasks.wander import Wander
from tb2rl.viz import subjects

QUICK = {"simulation": "kinematic", "n_envs": 8, "eval_episodes": 2, "eval_steps": 20, "save_freq": 0}
LINKS = {"src", "href", "xlink:href", "data", "action", "poster", "srcset"}


class _Ahead:
    """Takes the same action all the time; of named ones the first: forward."""

    def __init__(self, action: object = 0) -> None:
        self.action = np.array(action)

    def predict(self, observation, *, deterministic=False):
        return self.action, None


@dataclass(frozen=True)
class Cruise(Task):
    """Any speeds within a range; whoever gets into the upper half of the world has failed."""

    actions = Velocities(forward=(0.0, 0.5), turn=(-1.0, 1.0))

    def outcome(self, before, action, after):
        return Outcome(2 * after.twist[:, 0], failed={"bump": after.bumped, "strayed": after.pose[:, 1] > 0.0})


@dataclass(frozen=True)
class Errands(Wander):
    """Every episode has a goal of its own."""

    goal_task = True

    def initial_state(self, spec, draws):
        start = super().initial_state(spec, draws)
        start.goal[:] = draws.uniform(2)
        return start

    def outcome(self, before, action, after):
        outcome = super().outcome(before, action, after)
        return replace(outcome, succeeded={"goal": np.zeros(len(outcome.reward), dtype=bool)})


def _config(task: str | type[Task] = "maze", **settings) -> Config:
    """What the agent `random` would do; settings are those of the task."""
    return resolve("random", task, settings={f"task.{key}": value for key, value in settings.items()})


def _frames(path: Path) -> list[np.ndarray]:
    if path.suffix == ".mp4":
        with av.open(str(path)) as container:
            return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    with Image.open(path) as image:
        return [np.asarray((image.seek(i), image.convert("RGB"))[1]) for i in range(image.n_frames)]


def _seconds(path: Path) -> float:
    if path.suffix == ".mp4":
        with av.open(str(path)) as container:
            return container.duration / av.time_base
    with Image.open(path) as image:
        return sum((image.seek(i), image.info["duration"])[1] for i in range(image.n_frames)) / 1000


def _episode(path, actions, ended="time limit", failed=None) -> Episode:
    """An episode along a path (steps + 1, 2); a crash counts as failed, other endings as `failed` says."""
    path, actions = np.asarray(path, dtype=np.float32), np.asarray(actions)
    actions = actions.astype(np.uint8 if actions.ndim == 1 else np.float32)
    failed = ended == "collision" if failed is None else failed
    return Episode((0.0, 0.0, 0.0), ended, failed, ended == "goal", False, len(actions), 123.4, 5.0, path, actions)


def _evaluation(episodes: list[Episode], task: Task | None = None, **settings) -> Evaluation:
    """An evaluation of episodes that were not driven, at `maze` unless a task is given."""
    return Evaluation(episodes, make_scene(task or Wander(**settings), "discrete"), SEED)


def _evaluated(folder: Path, episodes: int, steps: int, ended: str = "time limit") -> None:
    """Keep an evaluation in a run folder whose episodes walk at random through the world."""
    config, rng = Run.open(folder).config, np.random.default_rng(0)
    x0, y0, x1, y1 = config.scene.world.bounds
    walks = rng.uniform((x0, y0), (x1, y1), (episodes, 1, 2)) + rng.normal(0, 0.1, (episodes, steps + 1, 2)).cumsum(1)
    paths = np.clip(walks, (x0, y0), (x1, y1))
    each = [
        _episode(path, taken, ended) for path, taken in zip(paths, rng.integers(3, size=(episodes, steps)), strict=True)
    ]
    evaluation = Evaluation(each, config.scene.changed(episode_steps=steps), SEED)
    Run.open(folder).write_evaluation(*evaluation.tree(config, str(folder)))


def _copied(run: Path, folder: Path, part: str = "train", **settings) -> Path:
    """A copy of a run folder that says to have been trained with other settings of a part of its config."""
    shutil.copytree(run, folder)
    tree = yaml.safe_load((folder / "config.yaml").read_text())
    tree[part].update(settings)
    (folder / "config.yaml").write_text(yaml.safe_dump(tree))
    return folder


class _Page(HTMLParser):
    """What a test asks a page: its text, its elements, and what it would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.source, self.words = text, []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    @classmethod
    def of(cls, *arguments: object) -> _Page:
        """The page that the command `report` makes of its arguments; its output belongs to the test."""
        report.main([*map(str, arguments)])
        out = arguments[arguments.index("--out") + 1] if "--out" in arguments else Path(arguments[0]) / "report.html"
        return cls(Path(out).read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes) -> None:
        self.elements.append((tag, dict(attributes)))

    def handle_data(self, data) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        """All that stands between tags, with plain single spaces."""
        return " ".join("".join(self.words).split())

    @property
    def ids(self) -> list[str]:
        return [attributes["id"] for _, attributes in self.elements if attributes.get("id")]

    @property
    def links(self) -> list[str]:
        """All that it refers to: within itself ("#..."), along with it ("data:..."), or elsewhere."""
        links = [value or "" for _, attributes in self.elements for key, value in attributes.items() if key in LINKS]
        return links + [
            link for found in re.findall(r"url\(([^)]*)\)|@import\s*([^;]*)", self.source) for link in found
        ]


@pytest.fixture
def make() -> SimpleNamespace:
    """The functions above that make something."""
    return SimpleNamespace(
        config=_config, policy=_Ahead, episode=_episode, evaluation=_evaluation, evaluated=_evaluated, copied=_copied
    )


@pytest.fixture
def frames():
    """The pictures of a film, each (height, width, 3)."""
    return _frames


@pytest.fixture
def seconds():
    """How long a film lasts."""
    return _seconds


@pytest.fixture
def pages() -> type[_Page]:
    """The class `_Page`."""
    return _Page


@pytest.fixture
def cruise() -> type[Task]:
    """A task with continuous actions."""
    return Cruise


@pytest.fixture
def errands() -> type[Task]:
    """A task with a goal of its own in each episode."""
    return Errands


@pytest.fixture
def brief(monkeypatch) -> None:
    """Evaluations that are made for a page: one episode."""
    monkeypatch.setattr(subjects, "_EPISODES", 1)


@pytest.fixture(scope="session")
def seeds(tmp_path_factory) -> Path:
    """A folder of runs of two seeds, as `train --seeds` leaves it; for reading only."""
    folder = tmp_path_factory.mktemp("runs") / "seeds"
    for seed in (0, 1):
        run = folder / f"seed-{seed}"
        train("qlearn", total_timesteps=24_000, eval_freq=12_000, seed=seed, folder=run, **QUICK)
        _evaluated(run, episodes=3, steps=50, ended="collision")
    return folder


@pytest.fixture(scope="session")
def goal_run(tmp_path_factory) -> Path:
    """A run of a network at a task with a goal, without evaluations of any kind; for reading only."""
    folder = tmp_path_factory.mktemp("runs") / "goal"
    train("dqn", task="wall", total_timesteps=8, eval_freq=0, folder=folder, **QUICK)
    return folder

"""Where the figures of a training go beside TensorBoard: MLflow, Weights & Biases, or a class of a user's own.

`train.track` names them: `mlflow`, `wandb`, or "module:Class".
"""

from __future__ import annotations

import inspect
import json
import os
import re
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.logger import Image, KVWriter, Logger

from tb2rl.core.errors import InputError, UnwritableError, install_extra, one_line, unknown
from tb2rl.core.files import read_text, write_text
from tb2rl.core.plugins import import_object
from tb2rl.runs.config import Config
from tb2rl.runs.folder import imports_limited
from tb2rl.training.callbacks import StopOnInterrupt

TRACKERS = {"mlflow": "tb2rl.training.mlflow_tracker:Mlflow", "wandb": "tb2rl.training.wandb_tracker:Wandb"}
_LIBRARIES = {"mlflow": "MLflow", "wandb": "Weights & Biases"}
MLFLOW_STORE = "MLFLOW_TRACKING_URI"  # the variable that MLflow itself reads
_FILES = ("sqlite:", "file:", "/", ".")  # stores that other machines do not have begin so
_ID = re.compile(r"[\w-]{1,64}")


@dataclass(frozen=True)
class Tracked:
    """A training as a tracker sees it.

    Attributes:
        folder: Its run folder.
        name: TASK/AGENT/NAME.
        settings: The config, numbers and text by dotted key.
    """

    folder: Path
    name: str
    settings: Mapping[str, Any]


class Tracker(KVWriter, ABC):
    """A writer of Stable-Baselines3's logger that knows whose figures it writes.

    Args:
        training: Whose.

    Attributes:
        id: What an earlier part of a resumed training gave to `remember`; None: nothing.
        ended: How the training ended, once `close` is called: "finished", "interrupted" or "failed".
    """

    ended = "failed"

    def __init__(self, training: Tracked) -> None:
        self.training = training
        kind = type(self)
        self._memory = training.folder / f"tracker-{kind.__module__}.{kind.__qualname__}.json"
        self.id, self._told = self._remembered()

    @abstractmethod
    def track(self, step: int, figures: Mapping[str, float], pictures: Mapping[str, np.ndarray]) -> None:
        """Take what the logger had at a control step; a training can have several lots for one step.

        Args:
            step: Control steps so far, over all environments.
            figures: What TensorBoard has as curves.
            pictures: Of shape (height, width, 3), bytes.
        """

    def write(self, key_values: Mapping[str, Any], key_excluded: Mapping[str, tuple[str, ...]], step: int = 0) -> None:
        """What the logger calls. Steps that were tracked before the training was resumed are left out."""
        shown = {key: value for key, value in key_values.items() if "tensorboard" not in (key_excluded.get(key) or ())}
        figures = {key: float(value) for key, value in shown.items() if isinstance(value, int | float | np.number)}
        pictures = {
            key: value.image
            for key, value in shown.items()
            if isinstance(value, Image) and isinstance(value.image, np.ndarray) and value.dataformats == "HWC"
        }
        if step > self._told:
            self.track(step, figures, pictures)

    def close(self) -> None:
        """The training is over."""

    def remember(self, name: str, step: int) -> None:
        """Keep in the run folder, for a resumed training, what the run is called there, and what has arrived.

        Args:
            name: Letters, digits, "-" and "_"; the `id` from then on.
            step: Control steps that are not tracked again.
        """
        self.id = name
        write_text(self._memory, json.dumps({"id": name, "step": step}) + "\n")

    def _remembered(self) -> tuple[str | None, int]:
        if not self._memory.is_file():
            return None, 0
        try:
            memory = json.loads(read_text(self._memory))
            if _ID.fullmatch(memory["id"]):
                return memory["id"], int(memory["step"])
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            pass
        raise InputError(f"{self._memory} is damaged: remove it, and the tracker begins a new run")


class _Guarded(KVWriter):
    """A tracker that is left out once it cannot write: no training is worth less for what it misses."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker, self._writes = tracker, True

    def write(self, key_values: Mapping[str, Any], key_excluded: Mapping[str, tuple[str, ...]], step: int = 0) -> None:
        if self._writes:
            with self._guard():
                self._tracker.write(key_values, key_excluded, step)

    def close(self) -> None:
        with self._guard():
            self._tracker.close()

    @contextmanager
    def _guard(self) -> Iterator[None]:
        try:
            yield
        except UnwritableError as error:
            if self._writes:
                print(f"warning: {error}; the training goes on without it", file=sys.stderr, flush=True)
            self._writes = False


def find_tracker(name: str) -> type[Tracker]:
    """The tracker of a name, or of "module:Class".

    Raises:
        InputError: If there is none, or its library is not installed.
    """
    if name not in TRACKERS and ":" not in name:
        raise unknown("tracker in train.track:", name, TRACKERS)
    try:
        found = import_object(TRACKERS.get(name, name))
    except InputError as error:
        raise InputError(f"train.track: {error}") from None
    except ModuleNotFoundError as error:
        if name not in TRACKERS:
            raise
        raise _missing(name, error) from None
    if not (isinstance(found, type) and issubclass(found, Tracker)) or inspect.isabstract(found):
        raise InputError(f"train.track: {name} is not a class derived from tb2rl.training.trackers.Tracker with track")
    return found


def _missing(name: str, error: ModuleNotFoundError) -> InputError:
    missing = "" if error.name == name else f" (there is no {error.name})"
    return InputError(f"train.track: {name} needs {_LIBRARIES[name]}{missing}: {install_extra(name)}")


def find_trackers(names: Sequence[str], folder: Path | None = None) -> list[type[Tracker]]:
    """The trackers of a training; where a run `folder` names them, it may name what its config may (see `core.trust`).

    Raises:
        InputError: If there is one that cannot be had.
    """
    with imports_limited(folder, trust=False):
        return [find_tracker(name) for name in names]


def check_trackers(config: Config, machines: bool) -> None:
    """Raise an `InputError` if trainings with this config cannot be tracked; `machines`: Ray is to do them."""
    find_trackers(config.train.track)
    store = os.environ.get(MLFLOW_STORE, "")
    if machines and "mlflow" in config.train.track and (not store or store.startswith(_FILES)):
        raise InputError(f"train.track: with --on ray, mlflow needs a server for all machines: set {MLFLOW_STORE}")


@contextmanager
def tracking(
    logger: Logger, trackers: Sequence[type[Tracker]], training: Tracked, stop: StopOnInterrupt
) -> Iterator[None]:
    """Let trackers have what a logger gets, and tell them how the block ended. The logger closes them."""
    ended = "failed"
    begun: list[Tracker] = []
    try:
        for tracker in trackers:
            begun.append(tracker(training))
            logger.output_formats.append(_Guarded(begun[-1]))
        yield
        ended = "interrupted" if stop.interrupted else "finished"
    except KeyboardInterrupt:
        ended = "interrupted"
        raise
    finally:
        for each in begun:
            each.ended = ended


@contextmanager
def tracker_troubles_named(name: str, *errors: type[Exception]) -> Iterator[None]:
    """Say in one line that a built-in tracker cannot write, which is what these errors of its library tell.

    Raises:
        InputError: If that is so.
    """
    caught: tuple[type[Exception], ...] = (OSError, ImportError, *errors)  # a store may need a driver
    try:
        yield
    except caught as error:
        raise UnwritableError(one_line(f"train.track: {name} cannot write: {error}")) from None


def runs_folder(folder: Path) -> Path:
    """The folder `runs` that a run folder is in, at any depth, else the one around it."""
    return next((each for each in folder.absolute().parents if each.name == "runs"), folder.absolute().parent)


def run_name(config: Config, folder: Path) -> str:
    """TASK/AGENT/NAME: a run folder's path within `runs`, or else what it is made of."""
    place = folder.absolute()
    if runs_folder(folder).name == "runs":
        return place.relative_to(runs_folder(folder)).as_posix()
    return "/".join([*(each.rpartition(":")[2] for each in (config.task_name, config.agent_name)), place.name])

"""Trackers: destinations of a training's figures beside TensorBoard, named by `train.track`.

A name is `mlflow`, `wandb`, or "module:Class" of a user's own class.
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
from tb2rl.runs.folder import restrict_imports
from tb2rl.training.callbacks import StopOnSignal

TRACKERS = {"mlflow": "tb2rl.training.mlflow_tracker:Mlflow", "wandb": "tb2rl.training.wandb_tracker:Wandb"}
_LIBRARIES = {"mlflow": "MLflow", "wandb": "Weights & Biases"}
MLFLOW_STORE = "MLFLOW_TRACKING_URI"  # the variable that MLflow itself reads
_LOCAL_STORES = ("sqlite:", "file:", "/", ".")  # prefixes of stores that other machines cannot reach
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
    """A writer of Stable-Baselines3's logger that sends the figures of one training elsewhere.

    Attributes:
        training: The training.
        id: The name given to `remember` before the training was resumed; None: there is none.
        ended: How the training ended, once `close` is called: "finished", "interrupted" or "failed".
    """

    ended = "failed"

    def __init__(self, training: Tracked) -> None:
        self.training = training
        kind = type(self)
        self._memory = training.folder / f"tracker-{kind.__module__}.{kind.__qualname__}.json"
        self.id, self._tracked_until = self._read_memory()
        self._can_write = True

    @abstractmethod
    def track(self, step: int, figures: Mapping[str, float], pictures: Mapping[str, np.ndarray]) -> None:
        """Send what the logger holds at a control step; there can be several calls for one step.

        Args:
            step: Control steps so far, over all environments.
            figures: TensorBoard's scalars.
            pictures: Arrays of bytes, shape (height, width, 3).
        """

    def write(self, key_values: Mapping[str, Any], key_excluded: Mapping[str, tuple[str, ...]], step: int = 0) -> None:
        """Called by the logger; skips steps that were tracked before the training was resumed."""
        shown = {key: value for key, value in key_values.items() if "tensorboard" not in (key_excluded.get(key) or ())}
        figures = {key: float(value) for key, value in shown.items() if isinstance(value, int | float | np.number)}
        pictures = {
            key: value.image
            for key, value in shown.items()
            if isinstance(value, Image) and isinstance(value.image, np.ndarray) and value.dataformats == "HWC"
        }
        if step > self._tracked_until and self._can_write:
            with self.dropping():
                self.track(step, figures, pictures)

    def close(self) -> None:
        """Called when the training is over."""

    @contextmanager
    def dropping(self) -> Iterator[None]:
        """Stop tracking with a warning if the block cannot write, because the training is worth no less."""
        try:
            yield
        except UnwritableError as error:
            if self._can_write:
                print(f"warning: {error}; the training goes on without it", file=sys.stderr, flush=True)
            self._can_write = False

    def remember(self, name: str, step: int) -> None:
        """Note in the run folder, for a resumed training, the name of the tracked run and the last step sent.

        Args:
            name: Letters, digits, "-" and "_"; the `id` from then on.
            step: Control steps that are not tracked again.
        """
        self.id = name
        write_text(self._memory, json.dumps({"id": name, "step": step}) + "\n")

    def _read_memory(self) -> tuple[str | None, int]:
        if not self._memory.is_file():
            return None, 0
        try:
            memory = json.loads(read_text(self._memory))
            if _ID.fullmatch(memory["id"]):
                return memory["id"], int(memory["step"])
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            pass
        raise InputError(f"{self._memory} is damaged: remove it, and the tracker begins a new run")


def _find_tracker(name: str) -> type[Tracker]:
    if name not in TRACKERS and ":" not in name:
        raise unknown("tracker in train.track:", name, TRACKERS)
    try:
        found = import_object(TRACKERS.get(name, name))
    except InputError as error:
        raise InputError(f"train.track: {error}") from None
    except ModuleNotFoundError as error:
        if name not in TRACKERS:
            raise
        missing = "" if error.name == name else f" (there is no {error.name})"
        raise InputError(f"train.track: {name} needs {_LIBRARIES[name]}{missing}: {install_extra(name)}") from None
    if not (isinstance(found, type) and issubclass(found, Tracker)) or inspect.isabstract(found):
        raise InputError(f"train.track: {name} is not a class derived from tb2rl.training.trackers.Tracker with track")
    return found


def find_trackers(names: Sequence[str], folder: Path | None = None) -> list[type[Tracker]]:
    """The tracker classes of some names; a run `folder` that names them limits imports, see `core.trust`.

    Raises:
        InputError: If there is no such tracker, or its library is not installed.
    """
    with restrict_imports(folder, trust=False):
        return [_find_tracker(name) for name in names]


def check_trackers(names: Sequence[str], on_cluster: bool) -> None:
    """Raise an `InputError` if trainings cannot be tracked by these names, by Ray on a cluster or on this machine."""
    find_trackers(names)
    store = os.environ.get(MLFLOW_STORE, "")
    if on_cluster and "mlflow" in names and (not store or store.startswith(_LOCAL_STORES)):
        raise InputError(f"train.track: with --on ray, mlflow needs a server for all machines: set {MLFLOW_STORE}")


@contextmanager
def tracking(
    logger: Logger, trackers: Sequence[type[Tracker]], training: Tracked, stop: StopOnSignal
) -> Iterator[None]:
    """Send a logger's output to trackers during the block, and tell them how it ended."""
    ended, begun = "failed", list[Tracker]()
    try:
        for tracker in trackers:
            begun.append(tracker(training))
            logger.output_formats.append(begun[-1])
        yield
        ended = "interrupted" if stop.received else "finished"
    except KeyboardInterrupt:
        ended = "interrupted"
        raise
    finally:
        for each in begun:
            logger.output_formats.remove(each)
            each.ended = ended
            with each.dropping():
                each.close()


@contextmanager
def translate_tracker_errors(name: str, *errors: type[Exception]) -> Iterator[None]:
    """Translate the errors of a tracker's library into an `UnwritableError`."""
    translated: tuple[type[Exception], ...] = (OSError, ImportError, *errors)  # a store may need a driver
    try:
        yield
    except translated as error:
        raise UnwritableError(one_line(f"train.track: {name} cannot write: {error}")) from None


def runs_folder(folder: Path) -> Path:
    """The folder `runs` around a run folder, at any depth, else its parent."""
    return next((each for each in folder.absolute().parents if each.name == "runs"), folder.absolute().parent)


def run_name(task_name: str, agent_name: str, folder: Path) -> str:
    """TASK/AGENT/NAME: a run folder's path within `runs`, or else made of its parts."""
    place = folder.absolute()
    if runs_folder(folder).name == "runs":
        return place.relative_to(runs_folder(folder)).as_posix()
    return "/".join([*(each.rpartition(":")[2] for each in (task_name, agent_name)), place.name])

"""Trackers: further destinations of a training's metrics beside TensorBoard, selected by `train.track`.

A tracker is selected by name (`mlflow`, `wandb`), or as "module:Class" of a user's own class.
"""

import inspect
import json
import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.logger import Image, KVWriter, Logger, filter_excluded_keys

from tb2rl.core import import_object, read_text, write_text
from tb2rl.core.errors import InputError, UnwritableError, install_extra, one_line, unknown
from tb2rl.runs import LIBRARY_ERRORS, restrict_imports
from tb2rl.training.callbacks import CheckpointCallback

TRACKERS = {"mlflow": "tb2rl.training.mlflow_tracker:Mlflow", "wandb": "tb2rl.training.wandb_tracker:Wandb"}
MLFLOW_URI = "MLFLOW_TRACKING_URI"  # environment variable with the address of the store
_LOCAL_STORES = ("sqlite:", "file:", "/", ".")  # prefixes of stores that other machines cannot reach


@dataclass(frozen=True)
class TrackedRun:
    """Description of a training for trackers."""

    folder: Path
    name: str  # see `run_name`
    settings: Mapping[str, Any]  # the config as numbers and text, by dotted key


class Tracker(KVWriter, ABC):
    """Base class of trackers: output formats of Stable-Baselines3's logger for one training.

    Attributes:
        training: Description of the training.
        id: Id of the tracker's own run, from the last call of `save_run`; None for a new training.
        ended: How the training ended: "finished", "interrupted" or "failed". It is set before `close` is called.
    """

    ended = "failed"

    def __init__(self, training: TrackedRun) -> None:
        self.training, self.id, self._tracked_until = training, None, 0
        self._can_write = True
        cls = type(self)
        self._state_file = training.folder / f"tracker-{cls.__module__}.{cls.__qualname__}.json"
        if self._state_file.is_file():
            try:
                state = json.loads(read_text(self._state_file))
                self.id, self._tracked_until = str(state["id"]), int(state["step"])
            except LIBRARY_ERRORS:
                raise InputError(f"{self._state_file} is damaged; remove it to start a new tracker run") from None

    @abstractmethod
    def track(self, step: int, figures: Mapping[str, float], pictures: Mapping[str, np.ndarray]) -> None:
        """Send the logged values of a control step; there can be several calls for the same step.

        Args:
            step: Control steps so far, over all environments.
            figures: Scalars, by TensorBoard's names.
            pictures: Images as arrays of bytes, shape (height, width, 3), by TensorBoard's names.
        """

    def write(self, key_values: Mapping[str, Any], key_excluded: Mapping[str, tuple[str, ...]], step: int = 0) -> None:
        """Track the values of the logger, except those of steps that were tracked before the training was resumed."""
        shown = filter_excluded_keys(dict(key_values), dict(key_excluded), "tensorboard")
        figures = {key: float(value) for key, value in shown.items() if isinstance(value, int | float | np.number)}
        images = {key: value for key, value in shown.items() if isinstance(value, Image) and value.dataformats == "HWC"}
        pictures = {key: value.image for key, value in images.items() if isinstance(value.image, np.ndarray)}
        if step > self._tracked_until and self._can_write:
            with self.disable_on_write_error():
                self.track(step, figures, pictures)

    def close(self) -> None:
        """Finish the tracker's own run at the end of the training."""

    @contextmanager
    def disable_on_write_error(self) -> Iterator[None]:
        """Disable tracking with a warning if the block cannot write; the training continues."""
        try:
            yield
        except UnwritableError as error:
            if self._can_write:
                print(f"warning: {error}; the training continues without it", file=sys.stderr, flush=True)
            self._can_write = False

    def save_run(self, run_id: str, step: int) -> None:
        """Save the id and the last step of the tracker's own run in the run folder, for a resumed training."""
        self.id = run_id
        write_text(self._state_file, json.dumps({"id": run_id, "step": step}) + "\n")


def _find_tracker(name: str) -> type[Tracker]:
    if name not in TRACKERS and ":" not in name:
        raise unknown("tracker in train.track:", name, TRACKERS)
    try:
        cls = import_object(TRACKERS.get(name, name))
    except InputError as error:
        raise InputError(f"train.track: {error}") from None
    except ModuleNotFoundError as error:
        if name not in TRACKERS:
            raise
        raise InputError(f"train.track: {name} needs the package {error.name}: {install_extra(name)}") from None
    if not (isinstance(cls, type) and issubclass(cls, Tracker)) or inspect.isabstract(cls):
        raise InputError(f"train.track: {name} is not a class derived from {Tracker.__module__}.Tracker with track()")
    return cls


def find_trackers(names: Sequence[str], untrusted_folder: Path | None = None) -> list[type[Tracker]]:
    """Find tracker classes by name; for names from the config in an `untrusted_folder`, see `restrict_imports`."""
    with restrict_imports(untrusted_folder, trust=False):
        return [_find_tracker(name) for name in names]


def check_trackers(names: Sequence[str], on_cluster: bool) -> None:
    """Raise an `InputError` if a tracker does not exist, or cannot be reached from a cluster."""
    find_trackers(names)
    store = os.environ.get(MLFLOW_URI, "")
    if on_cluster and "mlflow" in names and (not store or store.startswith(_LOCAL_STORES)):
        raise InputError(f"train.track: with --on ray, mlflow needs a server for all machines: set {MLFLOW_URI}")


@contextmanager
def attach_trackers(
    logger: Logger, classes: Sequence[type[Tracker]], training: TrackedRun, checkpoint_callback: CheckpointCallback
) -> Iterator[None]:
    """Attach trackers to a logger during the block, and close them with the outcome of the block."""
    ended, trackers = "failed", list[Tracker]()
    try:
        for cls in classes:
            trackers.append(cls(training))
            logger.output_formats.append(trackers[-1])
        yield
        ended = "interrupted" if checkpoint_callback.signal_number else "finished"
    except KeyboardInterrupt:
        ended = "interrupted"
        raise
    finally:
        for tracker in trackers:
            logger.output_formats.remove(tracker)
            tracker.ended = ended
            with tracker.disable_on_write_error():
                tracker.close()


@contextmanager
def translate_tracker_errors(name: str, *errors: type[Exception]) -> Iterator[None]:
    """Translate the errors of a tracker's library into an `UnwritableError`."""
    try:
        yield
    except errors as error:
        raise UnwritableError(one_line(f"train.track: {name} cannot write: {error}")) from None


def runs_folder(folder: Path) -> Path:
    """The nearest folder named `runs` above a run folder, or else the parent of the run folder."""
    parents = folder.absolute().parents
    return next((parent for parent in parents if parent.name == "runs"), parents[0])


def run_name(task_name: str, agent_name: str, folder: Path) -> str:
    """The path of a run folder relative to `runs`, or TASK/AGENT/NAME for a folder elsewhere."""
    runs = runs_folder(folder)
    if runs.name == "runs":
        return folder.absolute().relative_to(runs).as_posix()
    return "/".join([task_name.rpartition(":")[2], agent_name.rpartition(":")[2], folder.absolute().name])

"""MLflow as a tracker: settings are parameters, figures are metrics by control step, pictures are images."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
from filelock import FileLock

from tb2rl.training.trackers import MLFLOW_STORE, Tracked, Tracker, runs_folder, translate_tracker_errors

# MLflow reads these on import: no telemetry, no message for each new table, and 15 seconds instead of minutes for a
# server that does not answer.
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "WARNING")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "3")

from mlflow import MlflowClient, MlflowException
from mlflow.entities import Metric, Param
from sqlalchemy.exc import SQLAlchemyError

_WRITE_PERIOD = 1.0  # [s] between writes, because one takes the time of many control steps
_MOST = 100  # parameters or metrics in a call
_LONGEST = 6000  # characters of a parameter
_STATUS = {"finished": "FINISHED", "interrupted": "KILLED", "failed": "FAILED"}


class Mlflow(Tracker):
    """Writes to the store of `MLFLOW_TRACKING_URI`, else to a database beside the runs.

    The experiment is that of `MLFLOW_EXPERIMENT_NAME`, else "tb2rl". MLflow changes no parameters: a resumed training
    keeps those that it began with.
    """

    def __init__(self, training: Tracked) -> None:
        super().__init__(training)
        self._waiting: list[Metric] = []
        self._written = time.monotonic()
        with self._translated():
            self._open()

    def _open(self) -> None:
        """Continue the run of a resumed training, or begin one."""
        uri, artifacts = os.environ.get(MLFLOW_STORE), None
        lock: AbstractContextManager[Any] = nullcontext()
        if not uri:
            folder = runs_folder(self.training.folder) / "mlflow"
            folder.mkdir(exist_ok=True)
            uri, artifacts = f"sqlite:///{folder / 'mlflow.db'}?timeout=60", (folder / "artifacts").as_uri()
            lock = FileLock(folder / ".lock")  # two processes cannot make the tables at once
        with lock:
            self._client = MlflowClient(uri)
            experiment = self._experiment(artifacts)
        if not self._continue_run():
            settings = [Param(key, str(value)[:_LONGEST]) for key, value in self.training.settings.items()]
            self.remember(self._client.create_run(experiment, run_name=self.training.name).info.run_id, step=0)
            self._log(params=settings)

    def _experiment(self, artifacts: str | None) -> str:
        """The id of the experiment, which another training may make at the same time."""
        name = os.environ.get("MLFLOW_EXPERIMENT_NAME") or "tb2rl"
        try:
            return self._client.create_experiment(name, artifacts)
        except MlflowException:
            found = self._client.get_experiment_by_name(name)
            if found is None:
                raise
            return found.experiment_id

    def _continue_run(self) -> bool:
        """Mark the run of a resumed training as running; False: this store has none."""
        try:
            if self.id is not None:
                self._client.update_run(self.id, status="RUNNING")
        except MlflowException as error:
            if error.error_code != "RESOURCE_DOES_NOT_EXIST":
                raise
            self.id, self._tracked_until = None, 0
        return self.id is not None

    def track(self, step: int, figures: Mapping[str, float], pictures: Mapping[str, np.ndarray]) -> None:
        now = int(1000 * time.time())
        self._waiting += [Metric(key, value, now, step) for key, value in figures.items()]
        if pictures or time.monotonic() - self._written > _WRITE_PERIOD:
            with self._translated():
                for key, picture in pictures.items():
                    self._client.log_image(self.id, picture, key=key, step=step, synchronous=True)
                self._flush()

    def close(self) -> None:
        with self._translated():
            self._flush()
            self._client.set_terminated(self.id, _STATUS[self.ended])

    def _flush(self) -> None:
        if self._waiting:
            waiting, self._waiting = self._waiting, []
            self._log(metrics=waiting)
            self.remember(str(self.id), waiting[-1].step)
        self._written = time.monotonic()

    def _log(self, **values: Sequence[Any]) -> None:
        for kind, each in values.items():
            for i in range(0, len(each), _MOST):
                self._client.log_batch(self.id, **{kind: each[i : i + _MOST]})

    def _translated(self) -> AbstractContextManager[None]:
        return translate_tracker_errors("mlflow", MlflowException, SQLAlchemyError)

"""A training as a run of MLflow: settings are parameters, figures metrics by control step, pictures images."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
from filelock import FileLock

from tb2rl.training.trackers import MLFLOW_STORE, Tracked, Tracker, runs_folder, tracker_troubles_named

# MLflow reads these as it is imported. Nothing is sent to its makers, it does not tell of each table that it makes, and
# a server that is not there is asked for 15 seconds, not for minutes.
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "WARNING")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "3")

from mlflow import MlflowClient, MlflowException
from mlflow.entities import Metric, Param
from sqlalchemy.exc import SQLAlchemyError

_SECONDS = 1.0  # between two writings: one takes the time of many control steps
_MOST = 100  # parameters or metrics at once
_LONGEST = 6000  # characters of a parameter
_STATUS = {"finished": "FINISHED", "interrupted": "KILLED", "failed": "FAILED"}


class Mlflow(Tracker):
    """Writes to the store of `MLFLOW_TRACKING_URI`, else to a database beside the runs.

    The experiment is that of `MLFLOW_EXPERIMENT_NAME`, else "tb2rl". MLflow changes no parameters: those of a resumed
    training stay what it was begun with.
    """

    def __init__(self, training: Tracked) -> None:
        super().__init__(training)
        self._waiting: list[Metric] = []
        self._written = time.monotonic()
        with self._troubles_named():
            self._open()

    def _open(self) -> None:
        """Go on with the run of a resumed training, or begin one."""
        uri, place = os.environ.get(MLFLOW_STORE), None
        lock: AbstractContextManager[Any] = nullcontext()
        if not uri:
            folder = runs_folder(self.training.folder) / "mlflow"
            folder.mkdir(exist_ok=True)
            uri, place = f"sqlite:///{folder / 'mlflow.db'}?timeout=60", (folder / "artifacts").as_uri()
            lock = FileLock(folder / ".lock")  # two processes cannot make the tables at once
        with lock:
            self._client = MlflowClient(uri)
            experiment = self._experiment(place)
        if not self._goes_on():
            settings = [Param(key, str(value)[:_LONGEST]) for key, value in self.training.settings.items()]
            self.remember(self._client.create_run(experiment, run_name=self.training.name).info.run_id, step=0)
            self._log(params=settings)

    def _experiment(self, place: str | None) -> str:
        """The experiment, which another training may make at the same time."""
        name = os.environ.get("MLFLOW_EXPERIMENT_NAME") or "tb2rl"
        try:
            return self._client.create_experiment(name, place)
        except MlflowException:
            found = self._client.get_experiment_by_name(name)
            if found is None:
                raise
            return found.experiment_id

    def _goes_on(self) -> bool:
        """Whether there is a run to go on with in this store."""
        try:
            if self.id is not None:
                self._client.update_run(self.id, status="RUNNING")
        except MlflowException as error:
            if error.error_code != "RESOURCE_DOES_NOT_EXIST":
                raise
            self.id, self._told = None, 0
        return self.id is not None

    def track(self, step: int, figures: Mapping[str, float], pictures: Mapping[str, np.ndarray]) -> None:
        now = int(1000 * time.time())
        self._waiting += [Metric(key, value, now, step) for key, value in figures.items()]
        if pictures or time.monotonic() - self._written > _SECONDS:
            with self._troubles_named():
                for key, picture in pictures.items():
                    self._client.log_image(self.id, picture, key=key, step=step, synchronous=True)
                self._flush()

    def close(self) -> None:
        with self._troubles_named():
            self._flush()
            self._client.set_terminated(self.id, _STATUS[self.ended])

    def _flush(self) -> None:
        if self._waiting:
            waiting, self._waiting = self._waiting, []
            self._log(metrics=waiting)
            self.remember(str(self.id), waiting[-1].step)
        self._written = time.monotonic()

    def _log(self, **what: Sequence[Any]) -> None:
        for kind, values in what.items():
            for i in range(0, len(values), _MOST):
                self._client.log_batch(self.id, **{kind: values[i : i + _MOST]})

    def _troubles_named(self) -> Any:
        return tracker_troubles_named("mlflow", MlflowException, SQLAlchemyError)

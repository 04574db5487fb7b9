"""MLflow as a tracker: logs settings as parameters, scalars as metrics by control step, and pictures as images."""

import os
import time
from collections.abc import Mapping
from contextlib import nullcontext
from functools import partial

import numpy as np
from filelock import FileLock

from tb2rl.training.trackers import MLFLOW_URI, TrackedRun, Tracker, runs_folder, translate_tracker_errors

# MLflow reads these variables on import. They disable telemetry and messages about a new database, and shorten the
# timeout for an unreachable server from minutes to 15 s.
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_LOGGING_LEVEL", "WARNING")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "3")

from mlflow import MlflowClient, MlflowException
from mlflow.entities import Metric, Param
from sqlalchemy.exc import SQLAlchemyError

_WRITE_PERIOD = 1.0  # [s] between writes, because a write takes as long as many control steps
_MAX_PARAMETER_LENGTH = 6000  # characters, MLflow's limit
# ImportError is for a missing database driver.
_translate = partial(translate_tracker_errors, "mlflow", OSError, ImportError, MlflowException, SQLAlchemyError)
_STATUS = {"finished": "FINISHED", "interrupted": "KILLED", "failed": "FAILED"}


class Mlflow(Tracker):
    """Writes to the store at `MLFLOW_TRACKING_URI`, by default a database in the folder `runs/mlflow`.

    `MLFLOW_EXPERIMENT_NAME` is the name of the experiment, by default "tb2rl". A resumed training keeps its first
    parameters, because MLflow cannot change them.
    """

    @_translate()
    def __init__(self, training: TrackedRun) -> None:
        super().__init__(training)
        self._buffer: list[Metric] = []
        self._last_write_time = time.monotonic()
        uri, artifact_uri = os.environ.get(MLFLOW_URI), None
        folder = runs_folder(training.folder) / "mlflow"
        if not uri:
            folder.mkdir(exist_ok=True)
            artifact_uri = (folder / "artifacts").as_uri()
        # The lock is needed because two processes cannot create the tables at the same time.
        with nullcontext() if uri else FileLock(folder / ".lock"):
            self._client = MlflowClient(uri or f"sqlite:///{folder / 'mlflow.db'}?timeout=60")
            experiment_id = self._experiment_id(artifact_uri)
        if not self._continue_run():
            settings = [Param(key, str(value)[:_MAX_PARAMETER_LENGTH]) for key, value in training.settings.items()]
            self.save_run(self._client.create_run(experiment_id, run_name=training.name).info.run_id, step=0)
            self._client.log_batch(self.id, params=settings)

    def _experiment_id(self, artifact_uri: str | None) -> str:
        """Create the experiment, or find an existing one; return its id."""
        name = os.environ.get("MLFLOW_EXPERIMENT_NAME") or "tb2rl"
        try:
            return self._client.create_experiment(name, artifact_uri)
        except MlflowException:
            if existing := self._client.get_experiment_by_name(name):
                return existing.experiment_id
            raise

    def _continue_run(self) -> bool:
        """Mark the run of a resumed training as running; return whether the store has such a run."""
        try:
            if self.id is not None:
                self._client.update_run(self.id, status="RUNNING")
        except MlflowException as error:
            if error.error_code != "RESOURCE_DOES_NOT_EXIST":
                raise
            self.id, self._tracked_until = None, 0
        return self.id is not None

    @_translate()
    def track(self, step: int, figures: Mapping[str, float], pictures: Mapping[str, np.ndarray]) -> None:
        milliseconds = int(1000 * time.time())
        self._buffer += [Metric(key, value, milliseconds, step) for key, value in figures.items()]
        for key, picture in pictures.items():
            self._client.log_image(self.id, picture, key=key, step=step, synchronous=True)
        if pictures or time.monotonic() - self._last_write_time > _WRITE_PERIOD:
            self._flush()

    @_translate()
    def close(self) -> None:
        self._flush()
        self._client.set_terminated(self.id, _STATUS[self.ended])

    def _flush(self) -> None:
        self._last_write_time = time.monotonic()
        if self._buffer:
            metrics, self._buffer = self._buffer, []
            self._client.log_batch(self.id, metrics)
            self.save_run(str(self.id), metrics[-1].step)

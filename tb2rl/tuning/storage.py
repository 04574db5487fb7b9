"""Optuna's study in its database, with heartbeats of its running trials; its sampler and its pruner."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import optuna
from optuna.exceptions import ExperimentalWarning, StorageInternalError
from optuna.pruners import BasePruner, HyperbandPruner, MedianPruner, NopPruner
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.storages import RDBStorage
from sqlalchemy.exc import SQLAlchemyError

from tb2rl.core.errors import InputError, one_line
from tb2rl.training.error_translation import DISK_ERRORS
from tb2rl.tuning.study import DATABASE, StudyFolder, StudyOptions

SQLITE_TIMEOUT = 60  # [s] for which SQLite waits while another process writes
HEARTBEAT = 10  # [s] between heartbeats of a running trial
GRACE_PERIOD = 60  # [s] after the last heartbeat until a running trial counts as stale


@contextmanager
def open_study(folder: StudyFolder) -> Iterator[optuna.Study]:
    """Open the study in its database, or create it.

    Raises:
        InputError: If the database cannot be read or written, now or later in the block: it is locked, or the disk is
            full. Finished trials stay.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings(), _translate_errors(folder):
        warnings.simplefilter("ignore", ExperimentalWarning)
        # Optuna records heartbeats in `optimize` alone; `Heartbeats` does the same for `ask` and `tell`.
        warnings.filterwarnings("ignore", "Heartbeat of storage", UserWarning)
        with folder.lock():  # two processes cannot create the tables at once
            storage = make_storage(folder)
            study = optuna.create_study(
                storage=storage,
                study_name=folder.path.name,
                direction="maximize",
                load_if_exists=True,
                pruner=make_pruner(folder),
            )
        try:
            yield study
        finally:
            close_storage(storage)


class Heartbeats:
    """Records heartbeats of the trials that this process runs, in a thread; other processes fail stale trials."""

    def __init__(self, folder: StudyFolder) -> None:
        self._storage = make_storage(folder)
        self._study_id = self._storage.get_study_id_from_name(folder.path.name)
        self._trial_ids: dict[int, int] = {}  # by number
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._record, daemon=True)

    def add(self, number: int) -> None:
        """Record heartbeats of a trial from now on."""
        trial_id = self._storage.get_trial_id_from_study_id_trial_number(self._study_id, number)
        self._storage.record_heartbeat(trial_id)
        self._trial_ids[number] = trial_id

    def remove(self, number: int) -> None:
        """Record none of a trial any more."""
        del self._trial_ids[number]

    def _record(self) -> None:
        while not self._stop.wait(HEARTBEAT):
            for trial_id in list(self._trial_ids.values()):
                with suppress(StorageInternalError, SQLAlchemyError):  # the main thread reports such errors
                    self._storage.record_heartbeat(trial_id)

    def __enter__(self) -> Heartbeats:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        close_storage(self._storage)


def make_storage(folder: StudyFolder) -> RDBStorage:
    """Open the database."""
    url = storage_url(folder)
    return RDBStorage(
        url,
        engine_kwargs={"connect_args": {"timeout": SQLITE_TIMEOUT}} if url.startswith("sqlite") else {},
        heartbeat_interval=HEARTBEAT,
        grace_period=GRACE_PERIOD,
        heartbeat_stale_trial_callback=lambda _, trial: folder.remove_trial(trial.number),
    )


def close_storage(storage: RDBStorage) -> None:
    """Close the connections of a database."""
    storage.remove_session()
    storage.engine.dispose()


def storage_url(folder: StudyFolder) -> str:
    """The URL of the database."""
    return folder.options.storage or f"sqlite:///{folder.path / DATABASE}"


@contextmanager
def _translate_errors(folder: StudyFolder) -> Iterator[None]:
    what = f"the database of {folder.path}" if folder.options.storage else str(folder.path / DATABASE)
    reason: object
    try:
        yield
    except (StorageInternalError, SQLAlchemyError) as error:
        cause = error.__cause__ if isinstance(error, StorageInternalError) else error
        reason = getattr(cause, "orig", None) or cause or error
    except ImportError as error:  # of the driver that the URL names
        reason = error
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        what, reason = f"the folder {folder.path}", error.strerror
    else:
        return
    raise InputError(one_line(f"cannot use {what}: {reason}; finished trials stay, the same command continues"))


def count_evaluations(folder: StudyFolder) -> int:
    """Evaluations during a training of the default config."""
    settings = folder.default.train
    return -(-settings.total_timesteps // settings.eval_freq) if settings.eval_freq else 0


def make_pruner(folder: StudyFolder) -> BasePruner:
    """The pruner of the study's options."""
    count = count_evaluations(folder)
    if folder.options.pruner == "none" or count < 2:
        return NopPruner()
    if folder.options.pruner == "hyperband":
        return HyperbandPruner(min_resource=1, max_resource=count)
    return MedianPruner(n_startup_trials=5, n_warmup_steps=1 + count // 5)


def make_sampler(options: StudyOptions, trials: int) -> BaseSampler:
    """The sampler of the trial that follows so many.

    Its seed depends on the options and this number alone: processes that share a study draw different trials, and a
    study that is continued draws the same ones as one without a break.
    """
    seed = (options.seed + 1_000_003 * trials) % 2**32
    if options.sampler == "random":
        return RandomSampler(seed)
    return TPESampler(seed=seed, multivariate=True, constant_liar=True)  # running trials count as bad

"""Optuna's objects of a study: database, heartbeats of running trials, sampler and pruner."""

import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress

import optuna
from optuna.exceptions import ExperimentalWarning, StorageInternalError
from optuna.pruners import BasePruner, HyperbandPruner, MedianPruner, NopPruner
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.storages import RDBStorage
from sqlalchemy.exc import SQLAlchemyError

from tb2rl.core.errors import InputError, one_line
from tb2rl.training.error_translation import DISK_ERRORS
from tb2rl.tuning.study import DATABASE, StudyFolder, StudyOptions

SQLITE_TIMEOUT = 60  # [s] maximum wait for another process that writes
HEARTBEAT_PERIOD = 10  # [s] period of heartbeats of a running trial
GRACE_PERIOD = 60  # [s] time after the last heartbeat until a running trial is stale


@contextmanager
def open_study(folder: StudyFolder) -> Iterator[optuna.Study]:
    """Open the study in its database, or create it.

    Raises:
        InputError: If the database cannot be read or written, also during the block. Finished trials are kept.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings(), _translate_errors(folder):
        warnings.simplefilter("ignore", ExperimentalWarning)
        # Optuna warns, because only its `optimize` records heartbeats; here, the function `heartbeats` does.
        warnings.filterwarnings("ignore", "Heartbeat of storage", UserWarning)
        with ExitStack() as resources:
            with folder.lock():  # two processes cannot create the tables at once
                storage = resources.enter_context(closing(_Storage(folder)))
                study = optuna.create_study(
                    storage=storage,
                    study_name=folder.path.name,
                    direction="maximize",
                    load_if_exists=True,
                    pruner=make_pruner(folder),
                )
            yield study


@contextmanager
def heartbeats(folder: StudyFolder, running: Mapping[str, optuna.Trial]) -> Iterator[Callable[[optuna.Trial], None]]:
    """Record heartbeats of running trials in a thread; other processes mark trials without heartbeats as failed.

    Args:
        folder: Folder of the study.
        running: Running trials that this process asked for; the mapping may change during the block.

    Yields:
        A function that records one heartbeat of a trial.
    """
    with closing(_Storage(folder)) as storage:
        study_id, stop = storage.get_study_id_from_name(folder.path.name), threading.Event()

        def record(trial: optuna.Trial) -> None:
            storage.record_heartbeat(storage.get_trial_id_from_study_id_trial_number(study_id, trial.number))

        def record_all() -> None:
            while not stop.wait(HEARTBEAT_PERIOD):
                for trial in list(running.values()):
                    with suppress(StorageInternalError, SQLAlchemyError):  # the main thread raises these errors
                        record(trial)

        thread = threading.Thread(target=record_all, daemon=True)
        thread.start()
        try:
            yield record
        finally:
            stop.set()
            thread.join()


class _Storage(RDBStorage):
    """The database of a study."""

    def __init__(self, folder: StudyFolder) -> None:
        url = storage_url(folder)
        connect_args = {"timeout": SQLITE_TIMEOUT} if url.startswith("sqlite") else {}
        try:
            super().__init__(
                url,
                engine_kwargs={"connect_args": connect_args},
                heartbeat_interval=HEARTBEAT_PERIOD,
                grace_period=GRACE_PERIOD,
                heartbeat_stale_trial_callback=lambda _, trial: folder.remove_files(trial.number),
            )
        except ImportError as error:  # the database driver in the URL is missing
            raise InputError(one_line(f"cannot use the database of {folder.path}: {error}")) from None
        except SQLAlchemyError:
            if hasattr(self, "engine"):  # the URL was valid
                self.engine.dispose()
            raise

    def close(self) -> None:
        self.remove_session()
        self.engine.dispose()


def storage_url(folder: StudyFolder) -> str:
    """The URL of the database of a study."""
    return folder.options.storage or f"sqlite:///{folder.path / DATABASE}"


@contextmanager
def _translate_errors(folder: StudyFolder) -> Iterator[None]:
    try:
        yield
        return
    except (StorageInternalError, SQLAlchemyError) as error:
        cause = error.__cause__ if isinstance(error, StorageInternalError) else error
        reason = str(getattr(cause, "orig", None) or cause or error)
    except OSError as error:
        if error.errno not in DISK_ERRORS:
            raise
        reason = str(error.strerror)
    hint = "finished trials are kept; run the same command again to continue"
    raise InputError(one_line(f"cannot use the study {folder.path}: {reason}; {hint}"))


def make_pruner(folder: StudyFolder) -> BasePruner:
    """Make the pruner that the options of the study select."""
    num_evaluations = folder.num_evaluations
    if folder.options.pruner == "none" or num_evaluations < 2:
        return NopPruner()
    if folder.options.pruner == "hyperband":
        return HyperbandPruner(min_resource=1, max_resource=num_evaluations)
    return MedianPruner(n_startup_trials=5, n_warmup_steps=1 + num_evaluations // 5)


def make_sampler(options: StudyOptions, trial_number: int) -> BaseSampler:
    """Make the sampler for the trial with this number.

    The seed of the sampler depends only on the options and this number. Therefore processes that share a study sample
    different trials, and an interrupted study continues with the same trials.
    """
    seed = (options.seed + 1_000_003 * trial_number) % 2**32
    if options.sampler == "random":
        return RandomSampler(seed)
    # With `constant_liar`, running trials have a bad score, so that parallel trials differ.
    return TPESampler(seed=seed, multivariate=True, constant_liar=True)

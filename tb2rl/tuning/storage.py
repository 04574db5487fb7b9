"""Optuna's study in its database, its sampler and its pruner, and what goes wrong there in one line."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import optuna
from optuna.exceptions import ExperimentalWarning, StorageInternalError
from optuna.pruners import BasePruner, HyperbandPruner, MedianPruner, NopPruner
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.storages import RDBStorage
from sqlalchemy.exc import SQLAlchemyError

from tb2rl.core.errors import InputError, one_line
from tb2rl.training.error_translation import DISK_ERRORS
from tb2rl.tuning.study import DATABASE, Plan, Search

PATIENCE = 60  # [s] for which SQLite waits while another process writes


@contextmanager
def open_study(search: Search) -> Iterator[optuna.Study]:
    """The study in its database, which is made if there is none yet.

    Raises:
        InputError: If the database cannot be read or written, then or later in the block: it is locked, the disk is
            full. What was written before stays.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    url = storage_url(search)
    options = {"connect_args": {"timeout": PATIENCE}} if url.startswith("sqlite") else {}
    with warnings.catch_warnings(), _troubles_named(search):
        warnings.simplefilter("ignore", ExperimentalWarning)
        with search.lock():  # two processes cannot make the tables at once
            storage = RDBStorage(url, engine_kwargs=options)
            study = optuna.create_study(
                storage=storage,
                study_name=search.folder.name,
                direction="maximize",
                load_if_exists=True,
                pruner=pruner(search),
            )
        try:
            yield study
        finally:
            storage.remove_session()
            storage.engine.dispose()


def storage_url(search: Search) -> str:
    """The URL of the database."""
    return search.plan.storage or f"sqlite:///{search.folder / DATABASE}"


@contextmanager
def _troubles_named(search: Search) -> Iterator[None]:
    what = f"the database of {search.folder}" if search.plan.storage else str(search.folder / DATABASE)
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
        what, reason = f"the folder {search.folder}", error.strerror
    else:
        return
    raise InputError(one_line(f"cannot use {what}: {reason}; finished trials stay, the same command goes on"))


def evaluations(search: Search) -> int:
    """How many evaluations a training of the default config has on its way."""
    settings = search.default.train
    return -(-settings.total_timesteps // settings.eval_freq) if settings.eval_freq else 0


def pruner(search: Search) -> BasePruner:
    """What ends bad trials, as the plan says."""
    count = evaluations(search)
    if search.plan.pruner == "none" or count < 2:
        return NopPruner()
    if search.plan.pruner == "hyperband":
        return HyperbandPruner(min_resource=1, max_resource=count)
    return MedianPruner(n_startup_trials=5, n_warmup_steps=1 + count // 5)


def sampler(plan: Plan, trials: int) -> BaseSampler:
    """What proposes the next trial after so many.

    It follows from these, not from the process that asks: two that share a study draw different trials, and one that
    goes on draws those that it would have drawn.
    """
    seed = (plan.seed + 1_000_003 * trials) % 2**32
    if plan.sampler == "random":
        return RandomSampler(seed)
    return TPESampler(seed=seed, multivariate=True, constant_liar=True)  # what runs counts as bad: it is elsewhere

"""Databases that are locked, full or missing: one line, and no finished trial is lost."""

import errno
import os
import sqlite3
from contextlib import ExitStack, closing, contextmanager

import pytest
import sqlalchemy
from optuna import TrialPruned

from tb2rl.core.errors import InputError
from tb2rl.tuning import storage, training
from tb2rl.tuning.storage import open_study
from tb2rl.tuning.trials import count_trials, run_trials


@pytest.fixture
def begun(make_folder, executor, untrained, monkeypatch):
    """A study of two complete trials in a database of its own; trainings take no time."""
    folder = make_folder(storage="sqlite:///other.db")
    monkeypatch.setattr(storage, "SQLITE_TIMEOUT", 0.1)
    monkeypatch.setattr("optuna.storages._rdb.storage.time.sleep", lambda _: None)
    with open_study(folder) as study:
        run_trials(folder, study, 2, executor)
    return folder


@contextmanager
def locked():
    with closing(sqlite3.connect("other.db", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        yield
        other.execute("ROLLBACK")


@contextmanager
def full():
    """No room for another page."""
    with closing(sqlite3.connect("other.db")) as other:
        (pages,) = other.execute("PRAGMA page_count").fetchone()

    def limit(connection, _):
        connection.execute(f"PRAGMA max_page_count = {pages}")

    sqlalchemy.event.listen(sqlalchemy.Engine, "connect", limit)
    try:
        yield
    finally:
        sqlalchemy.event.remove(sqlalchemy.Engine, "connect", limit)


@pytest.mark.parametrize(("trouble", "words"), [(locked, "database is locked"), (full, "database or disk is full")])
def test_a_database_that_cannot_be_written_loses_no_finished_trial(begun, executor, trouble, words, read_study):
    _, before = read_study(begun.path)
    with pytest.raises(InputError, match=words) as raised, trouble(), open_study(begun) as study:
        run_trials(begun, study, 400, executor)  # more than there is room for
    assert "finished trials are kept; run the same command again to continue" in str(raised.value)
    _, kept = read_study(begun.path)
    assert kept[:2] == before
    finished = [trial for trial in kept if trial.state.is_finished()]
    with open_study(begun) as study:
        run_trials(begun, study, len(finished) + 1, executor)
        assert study.trials[: len(finished)] == finished


def test_a_database_that_is_locked_when_a_trial_ends_loses_that_one_at_most(begun, executor, monkeypatch, read_study):
    def train_and_lock(*_):
        stack.enter_context(locked())
        raise TrialPruned

    monkeypatch.setattr(training, "_train", train_and_lock)
    with pytest.raises(InputError, match="database is locked"), ExitStack() as stack, open_study(begun) as study:
        run_trials(begun, study, 3, executor)
    _, trials = read_study(begun.path)
    assert [trial.state.name for trial in trials] == ["COMPLETE", "COMPLETE", "RUNNING"], "until its heartbeat is stale"


def test_a_full_disk_ends_the_study_and_not_the_trial_alone(make_folder, executor, monkeypatch):
    def write(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tb2rl.runs.folder.write_checkpoint", write)
    folder = make_folder()
    with pytest.raises(InputError, match="No space left on device"), open_study(folder) as study:
        run_trials(folder, study, 3, executor)
    with open_study(folder) as study:
        assert count_trials(study) == {"complete": 0, "pruned": 0, "failed": 1}


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("sqlite:///no/such/folder/study.db", "unable to open database file"),
        ("nonsense", "Could not parse SQLAlchemy URL"),
        ("oracle://user:secret@host/study", "Failed to import DB access module"),
    ],
)
def test_a_missing_database_is_one_line_without_its_password(make_folder, url, words):
    with pytest.raises(InputError, match=words) as raised, open_study(make_folder(storage=url)):
        pass
    assert "secret" not in str(raised.value)
    assert "\n" not in str(raised.value)

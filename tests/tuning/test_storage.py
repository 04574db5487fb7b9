"""Databases that are locked, full or missing: one line, and no finished trial is lost."""

from __future__ import annotations

import errno
import os
import sqlite3
from contextlib import ExitStack, closing, contextmanager

import pytest
import sqlalchemy

from tb2rl.core.errors import InputError
from tb2rl.tuning import storage, training
from tb2rl.tuning.storage import open_study
from tb2rl.tuning.study import DATABASE
from tb2rl.tuning.training import TrainingResult
from tb2rl.tuning.trials import count_trials, run_trials


@pytest.fixture
def begun(make_folder, executor, monkeypatch):
    """A study of two complete trials, whose trainings take no time."""
    folder = make_folder()
    monkeypatch.setattr(storage, "SQLITE_TIMEOUT", 0.1)
    monkeypatch.setattr("optuna.storages._rdb.storage.time.sleep", lambda _: None)
    monkeypatch.setattr(training, "_train", lambda _, trial: [TrainingResult(trial.params["agent.gamma"], 1.0, 1.0)])
    with open_study(folder) as study:
        run_trials(folder, study, 2, executor)
    return folder


def values(folder):
    with open_study(folder) as study:
        return [trial.value for trial in study.trials if trial.value is not None]


@contextmanager
def locked(folder):
    with closing(sqlite3.connect(folder.path / DATABASE, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        yield
        other.execute("ROLLBACK")


@contextmanager
def full(folder):
    """No room for another page."""
    with closing(sqlite3.connect(folder.path / DATABASE)) as other:
        (pages,) = other.execute("PRAGMA page_count").fetchone()

    def limit(connection, _):
        connection.execute(f"PRAGMA max_page_count = {pages}")

    sqlalchemy.event.listen(sqlalchemy.Engine, "connect", limit)
    try:
        yield
    finally:
        sqlalchemy.event.remove(sqlalchemy.Engine, "connect", limit)


@pytest.mark.parametrize(("trouble", "words"), [(locked, "database is locked"), (full, "database or disk is full")])
def test_a_database_that_cannot_be_written_loses_no_finished_trial(begun, executor, trouble, words):
    before = values(begun)
    with pytest.raises(InputError, match=words) as raised, trouble(begun), open_study(begun) as study:
        run_trials(begun, study, 400, executor)  # more than there is room for
    assert "\n" not in str(raised.value)
    assert "finished trials stay, the same command continues" in str(raised.value)
    done = values(begun)
    assert done[: len(before)] == before
    with open_study(begun) as study:
        run_trials(begun, study, len(done) + 2, executor)
    assert values(begun)[: len(done)] == done


def test_a_database_that_is_locked_when_a_trial_ends_loses_that_one_at_most(begun, executor, monkeypatch):
    before, train = values(begun), training._train

    def train_and_lock(folder, trial):
        stack.enter_context(locked(begun))
        return train(folder, trial)

    monkeypatch.setattr(training, "_train", train_and_lock)
    with pytest.raises(InputError, match="database is locked"), ExitStack() as stack, open_study(begun) as study:
        run_trials(begun, study, 3, executor)
    with open_study(begun) as study:
        assert [trial.state.name for trial in study.trials[2:]] == ["RUNNING"], "until its heartbeat is stale"
    assert values(begun) == before


def test_a_full_disk_ends_the_study_and_not_the_trial_alone(make_folder, executor, monkeypatch):
    folder = make_folder()

    def write(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tb2rl.runs.folder.write_checkpoint", write)
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


def test_another_database_has_the_study(make_folder, tmp_path):
    folder = make_folder(storage=f"sqlite:///{tmp_path / 'other.db'}")
    with open_study(folder):
        pass
    assert (tmp_path / "other.db").is_file()
    assert not (folder.path / DATABASE).exists()

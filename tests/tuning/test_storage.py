"""Databases that are locked or full: one line, and no finished trial is lost."""

from __future__ import annotations

import errno
import os
import sqlite3
from contextlib import ExitStack, closing, contextmanager

import pytest
import sqlalchemy

from tb2rl.core.errors import InputError
from tb2rl.tuning import storage, trials
from tb2rl.tuning.storage import open_study
from tb2rl.tuning.study import DATABASE
from tb2rl.tuning.trials import Outcome, counts, run_trials


@pytest.fixture
def begun(search, monkeypatch):
    """A study of two finished trials, whose trainings take no time."""
    it = search()
    monkeypatch.setattr(storage, "PATIENCE", 0.1)
    monkeypatch.setattr("optuna.storages._rdb.storage.time.sleep", lambda _: None)
    monkeypatch.setattr(trials, "train_trial", lambda _, trial: [Outcome(trial.params["agent.gamma"], 1.0, 1.0)])
    with open_study(it) as study:
        run_trials(it, study, 2)
    return it


def values(it):
    with open_study(it) as study:
        assert counts(study)["complete"] == len([trial.value for trial in study.trials if trial.value])
        return [trial.value for trial in study.trials if trial.value is not None]


@contextmanager
def locked(it):
    with closing(sqlite3.connect(it.folder / DATABASE, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        yield
        other.execute("ROLLBACK")


@contextmanager
def full(it):
    """As if there were no more room on the disk than the database has now: SQLite's own limit, and its own error."""
    with closing(sqlite3.connect(it.folder / DATABASE)) as other:
        (pages,) = other.execute("PRAGMA page_count").fetchone()

    def limit(connection, _):
        connection.execute(f"PRAGMA max_page_count = {pages}")

    sqlalchemy.event.listen(sqlalchemy.Engine, "connect", limit)
    try:
        yield
    finally:
        sqlalchemy.event.remove(sqlalchemy.Engine, "connect", limit)


@pytest.mark.parametrize(("trouble", "words"), [(locked, "database is locked"), (full, "database or disk is full")])
def test_a_database_that_cannot_be_written_loses_no_finished_trial(begun, trouble, words):
    before = values(begun)
    with pytest.raises(InputError, match=words) as raised, trouble(begun), open_study(begun) as study:
        run_trials(begun, study, 400)  # more than there is room for
    assert "\n" not in str(raised.value)
    assert "finished trials stay, the same command goes on" in str(raised.value)
    done = values(begun)
    assert done[: len(before)] == before
    with open_study(begun) as study:
        run_trials(begun, study, len(done) + 2)
    assert values(begun)[: len(done)] == done
    assert len(values(begun)) == len(done) + 2


def test_a_database_that_is_locked_while_a_trial_ends_loses_that_one_at_most(begun, monkeypatch):
    before, train = values(begun), trials.train_trial

    def train_and_lock(search, trial):
        outcomes = train(search, trial)
        stack.enter_context(locked(search))
        return outcomes

    monkeypatch.setattr(trials, "train_trial", train_and_lock)
    with pytest.raises(InputError, match="database is locked"), ExitStack() as stack, open_study(begun) as study:
        run_trials(begun, study, 3)
    monkeypatch.setattr(trials, "train_trial", train)
    with open_study(begun) as study:
        run_trials(begun, study, 3)
        assert counts(study) == {"complete": 3, "pruned": 0, "lost": 1}
    assert values(begun)[:2] == before


def test_a_disk_that_is_full_ends_the_study_and_not_the_trial_alone(search, monkeypatch):
    it = search()

    def write(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr("tb2rl.runs.folder.write_checkpoint", write)
        with pytest.raises(InputError, match="No space left on device"), open_study(it) as study:
            run_trials(it, study, 3)
    with open_study(it) as study:
        assert [trial.state.name for trial in study.trials] == ["RUNNING"]
        run_trials(it, study, 1)
        assert counts(study) == {"complete": 1, "pruned": 0, "lost": 1}


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("sqlite:///no/such/folder/study.db", "unable to open database file"),
        ("nonsense", "Could not parse SQLAlchemy URL"),
        ("oracle://user:secret@host/study", "Failed to import DB access module"),
    ],
)
def test_a_database_that_is_not_there_is_one_line_without_its_password(search, url, words):
    with pytest.raises(InputError, match=words) as raised, open_study(search(storage=url)):
        pass
    assert "secret" not in str(raised.value)
    assert "\n" not in str(raised.value)


def test_another_database_has_the_study(search, tmp_path):
    it = search(storage=f"sqlite:///{tmp_path / 'elsewhere.db'}")
    with open_study(it):
        pass
    assert (tmp_path / "elsewhere.db").is_file()
    assert not (it.folder / DATABASE).exists()

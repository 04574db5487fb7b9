"""Checkpoints can come from anybody: reading one runs no code and ends in a policy or in one line."""

from __future__ import annotations

import gc
import io
import os
import pickle
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch as th

from tb2rl.runs.folder import Run
from tb2rl.runs.loading import load
from tb2rl.training.training import resume


@pytest.mark.parametrize(
    "count", [pytest.param(20, marks=pytest.mark.slow), pytest.param(1200, marks=pytest.mark.fuzz)]
)
def test_a_damaged_checkpoint_works_or_is_refused_in_one_line(count, runs, isolated):
    outcomes = [isolated(runs=runs, number=number) for number in range(count)]
    assert [why for outcome, why in outcomes if outcome == "failed"] == []
    assert sum(outcome == "refused" for outcome, _ in outcomes) > count / 2, "the damage is too small to see"


class Payload:
    """Code that an attacker hides in a pickle: it makes a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Callable, tuple[str]]:
        return os.mkdir, (str(self.folder),)


def pickled(marker: Path) -> Iterator[bytes]:
    """Files with the payload: pickles, torch's archives, numpy's arrays."""
    payload = Payload(marker)
    yield from (pickle.dumps(payload, protocol) for protocol in (0, 4))
    for save in (lambda file: th.save(payload, file), lambda file: np.save(file, np.array([payload], dtype=object))):
        file = io.BytesIO()
        save(file)
        yield file.getvalue()


def test_a_pickle_is_refused_and_runs_nothing(runs, refused, tmp_path):
    marker = tmp_path / "executed"
    pickle.loads(next(pickled(marker)))
    marker.rmdir()  # the payload works
    run = Run.open(shutil.copytree(runs / "dqn", tmp_path / "run"))
    for content in pickled(marker):
        for file in (tmp_path / "policy.zip", run.checkpoints[0]):
            file.write_bytes(content)
            assert "is not a checkpoint" in refused(load, file)
        for attempt in (load, resume):
            assert "is not a checkpoint" in refused(attempt, run.folder)
    (run.folder / "config.yaml").write_text(f"agent: !!python/object/apply:os.mkdir [{marker}]\n")
    for attempt in (load, resume):
        assert "config.yaml is not" in refused(attempt, run.folder)
    assert not marker.exists()


@pytest.mark.parametrize("reference", ["os:remove:{file}", "subprocess:call:{file}", "gc:freeze"])
def test_a_world_reference_calls_only_functions_that_make_worlds(reference, runs, edited, refused, tmp_path):
    precious = tmp_path / "precious"
    precious.write_text(f"#!/bin/sh\ntouch {tmp_path / 'executed'}\n")
    precious.chmod(0o700)
    world = reference.format(file=precious)
    evil = edited(Run.open(runs / "qlearn").checkpoints[0], tmp_path / "evil.safetensors", "config/task/world", world)
    assert str(evil) in refused(load, evil)
    run = shutil.copytree(runs / "qlearn", tmp_path / "run")
    config = run / "config.yaml"
    config.write_text(config.read_text().replace("world: loop", f"world: {world}"))
    for attempt in (load, resume):
        assert "config.yaml is not a run's config" in refused(attempt, run)
    assert precious.is_file()
    assert not (tmp_path / "executed").exists()
    assert gc.get_freeze_count() == 0

"""Checkpoints can come from anybody: reading one runs no code and ends in a policy or in one line.

Files that may hang, crash or exhaust memory are tried in a separate process, see `untrusted/__main__.py`.
"""

from __future__ import annotations

import gc
import io
import json
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th

from tb2rl.runs.folder import Run
from tb2rl.runs.loading import load
from tb2rl.training.training import resume

PROGRAM = Path(__file__).with_name("untrusted")
FAMILIES = ["damage 600", "states"]


def tried(runs: Path, family: str, folder: Path) -> list[dict[str, Any]]:
    """The outcome of every case of a family; after a process dies, another one continues with the next case."""
    lines, work = folder / "report.jsonl", folder / "work"
    report: list[dict[str, Any]] = []
    environment = {**os.environ, "MALLOC_ARENA_MAX": "2", "OMP_NUM_THREADS": "1"}
    while True:
        lines.write_text("")
        arguments = [sys.executable, PROGRAM, runs, family, str(len(report)), work, lines]
        with (folder / "stderr").open("wb") as stderr:
            done = subprocess.run(
                arguments, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=stderr
            )
        found = [json.loads(line) for line in lines.read_text().splitlines()]
        ended = [line for line in found if "outcome" in line]
        if done.returncode == 0:
            return report + ended
        trace = (folder / "stderr").read_text(errors="replace")[-3000:]
        assert found, f"it did not die of a case: {trace}"
        dead = {**found[-1], "outcome": "died", "status": done.returncode, "trace": trace}
        report += [*(line for line in ended if line["number"] != dead["number"]), dead]


@pytest.mark.parametrize(
    "family",
    [pytest.param("damage 20", marks=pytest.mark.slow), *(pytest.param(f, marks=pytest.mark.fuzz) for f in FAMILIES)],
)
def test_an_untrusted_checkpoint_works_or_is_refused_in_one_line(family, runs, tmp_path):
    report = tried(runs, family, tmp_path)
    assert len(report) >= 20
    assert [line for line in report if line["outcome"] not in ("works", "refused")] == []
    assert sum(line["outcome"] == "refused" for line in report) > len(report) / 2, "the damage is too small to see"


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

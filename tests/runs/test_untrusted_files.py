"""Checkpoints can come from anybody: reading one runs no code and ends in a policy or in one line."""

import gc
import io
import json
import os
import pickle
import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch as th

from tb2rl.core.errors import InputError
from tb2rl.runs.folder import Run
from tb2rl.runs.loading import load
from tb2rl.training.training import resume


def damaged(content: bytes, rng: random.Random) -> bytes:
    """A checkpoint with flipped bits, a part missing, or another value somewhere in its tree."""
    damage = rng.choice(["bits", "end", "tree", "tree"])
    if damage == "end":
        return content[: rng.randrange(len(content))]
    length = int.from_bytes(content[:8], "little")
    if damage == "bits":
        flipped = bytearray(content)
        for _ in range(rng.choice([1, 10, 100])):
            flipped[rng.randrange(rng.choice([length, len(content)]))] ^= 1 << rng.randrange(8)
        return bytes(flipped)
    header = json.loads(content[8 : 8 + length])
    metadata = json.loads(header["__metadata__"]["tb2rl"])
    branch, key = metadata, "content"
    while isinstance(branch[key], dict | list) and branch[key] and rng.random() < 0.8:
        branch = branch[key]
        key = rng.choice(list(branch) if isinstance(branch, dict) else range(len(branch)))
    branch[key] = rng.choice([None, True, -1, 1e308, 10**18, 2**64, "", "os:system", [], {}, {"$array": "0"}])
    header["__metadata__"]["tb2rl"] = json.dumps(metadata)
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + content[8 + length :]


@pytest.mark.parametrize("count", [5, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("agent", ["qlearn", "dqn", "ppo"])
@pytest.mark.filterwarnings("ignore")
def test_a_damaged_checkpoint_works_or_is_refused_in_one_line(agent, count, runs, tmp_path):
    refusals = []
    for number in range(count):
        run = Run.open(shutil.copytree(runs / agent, tmp_path / str(number)))
        file = run.checkpoints[0]
        file.write_bytes(damaged(file.read_bytes(), random.Random(number)))
        try:
            load(file)
            resume(run.folder)
        except InputError as error:
            refusals.append(str(error))
    assert len(refusals) > count / 4, "the damage is too small to see"
    assert [message for message in refusals if len(message.splitlines()) != 1] == []


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
        assert "config.yaml as YAML" in refused(attempt, run.folder)
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

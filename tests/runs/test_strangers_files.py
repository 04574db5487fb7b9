"""A checkpoint may come from anybody: reading one runs nothing, writes nothing, and ends in a policy or in one line.

Files that may hang, crash or ask for all memory are tried in a process of their own, see `strangers/__main__.py`.
"""

from __future__ import annotations

import base64
import gc
import io
import json
import os
import pickle
import resource
import shutil
import subprocess
import sys
import tarfile
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.save_util import load_from_zip_file

from tb2rl.runs.folder import Run
from tb2rl.runs.loading import load
from tb2rl.training.training import resume

PROGRAM = Path(__file__).with_name("strangers")
LARGE = 600  # files with damage at random


def tried(runs: Path, family: str, folder: Path) -> list[dict[str, Any]]:
    """What became of every case of a family; a process that dies of one, or soon after, is followed by another."""
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
        dead = {"executed": False, **found[-1], "outcome": "died", "status": done.returncode, "trace": trace}
        report += [*(line for line in ended if line["number"] != dead["number"]), dead]


def failures(report: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [line for line in report if line["outcome"] not in ("works", "refused")]


@pytest.mark.parametrize("count", [20, pytest.param(LARGE, marks=pytest.mark.slow)])
def test_a_damaged_checkpoint_works_or_is_refused_in_one_line(count, runs, tmp_path):
    report = tried(runs, f"damage {count}", tmp_path)
    assert len(report) >= count
    assert failures(report) == []
    assert sum(line["outcome"] == "refused" for line in report) > count / 2, "the damage is too small to see"


@pytest.mark.slow
@pytest.mark.parametrize("family", ["claims", "states"])
def test_what_a_checkpoint_claims_costs_no_memory_nor_time(family, runs, tmp_path):
    report = tried(runs, family, tmp_path)
    assert len(report) > 200
    assert failures(report) == []


@pytest.mark.slow
@pytest.mark.parametrize("agent", ["qlearn", "dqn", "ppo"])
def test_a_pickle_in_any_place_of_a_checkpoint_runs_nothing(agent, runs, tmp_path):
    report = tried(runs, f"pickles {agent}", tmp_path)
    assert len(report) > 100
    assert [line for line in report if line["executed"]] == []
    assert failures(report) == []


# ---- whole files that run something in a reader that trusts them


class Payload:
    """What an attacker hides in a pickle: here it makes a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Callable, tuple[str]]:
        return os.mkdir, (str(self.folder),)


def pickled_things(marker: Path) -> Iterator[tuple[str, str, bytes]]:
    """Name, suffix and content of files."""
    payload = Payload(marker)
    for protocol in (0, 2, 4):
        yield f"pickle {protocol}", ".pkl", pickle.dumps(payload, protocol)
    for new_format in (True, False):
        file = io.BytesIO()
        th.save({"policy": payload}, file, _use_new_zipfile_serialization=new_format)
        yield f"torch.save {new_format}", ".pt", file.getvalue()
    yield "SB3 zip, data", ".zip", stable_baselines_zip(pickle.dumps(payload), {"policy": {}})
    yield "SB3 zip, parameters", ".zip", stable_baselines_zip(pickle.dumps(1), {"policy": payload})
    for save, suffix in ((np.save, ".npy"), (np.savez, ".npz")):
        file = io.BytesIO()
        save(file, np.array([payload], dtype=object))
        yield suffix, suffix, file.getvalue()


def stable_baselines_zip(data: bytes, parameters: dict[str, Any]) -> bytes:
    file, tensors = io.BytesIO(), io.BytesIO()
    th.save(parameters, tensors)
    entry = {":type:": "<class 'dict'>", ":serialized:": base64.b64encode(data).decode()}
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", json.dumps({"policy_class": entry}))
        archive.writestr("policy.pth", tensors.getvalue())
        archive.writestr("_stable_baselines3_version", "2.0.0")
    return file.getvalue()


def load_trusting(file: Path) -> None:
    """As Stable-Baselines3 did before torch read weights only."""
    with suppress(pickle.UnpicklingError):  # the tensors
        load_from_zip_file(file)
    with zipfile.ZipFile(file) as archive:
        th.load(io.BytesIO(archive.read("policy.pth")), weights_only=False)


def test_the_payloads_work_in_readers_that_trust_them(tmp_path):
    readers = {
        ".pkl": lambda file: pickle.loads(file.read_bytes()),
        ".pt": lambda file: th.load(file, weights_only=False),
        ".npy": lambda file: np.load(file, allow_pickle=True),
        ".npz": lambda file: np.load(file, allow_pickle=True)["arr_0"],
        ".zip": load_trusting,
    }
    for name, suffix, content in pickled_things(tmp_path / "executed"):
        file = tmp_path / f"file{suffix}"
        file.write_bytes(content)
        with suppress(Exception):  # what it makes of the folder that it gets is another matter
            readers[suffix](file)
        assert (tmp_path / "executed").is_dir(), name
        (tmp_path / "executed").rmdir()


def test_a_file_that_is_a_pickle_runs_nothing(runs, refused, tmp_path):
    run = Run.open(shutil.copytree(runs / "dqn", tmp_path / "run"))
    for name, suffix, content in pickled_things(tmp_path / "executed"):
        for file in (tmp_path / f"policy{suffix}", tmp_path / "policy.safetensors", run.checkpoints[0]):
            file.write_bytes(content)
            assert "is not a checkpoint" in refused(load, file)
        for attempt in (load, resume):
            assert "is not a checkpoint" in refused(attempt, run.folder)
        assert not (tmp_path / "executed").exists(), name


def test_a_pickle_in_a_runs_config_runs_nothing(runs, refused, tmp_path):
    run = shutil.copytree(runs / "qlearn", tmp_path / "run")
    for tag in ("!!python/object/apply:os.mkdir", "!!python/object/new:os.mkdir", "!!python/name:os.mkdir"):
        (run / "config.yaml").write_text(f"agent: {tag} [{tmp_path / 'executed'}]\n")
        for attempt in (load, resume):
            assert "config.yaml is not" in refused(attempt, run)
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize("reference", ["os:remove:{file}", "subprocess:call:{file}", "gc:freeze"])
def test_a_worlds_name_in_a_config_calls_nothing_but_what_makes_worlds(reference, runs, edited, refused, tmp_path):
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


# ---- archives


def bombs() -> Iterator[bytes]:
    """Zips whose one member is 200 MB of zeros: alone, and one within the other."""
    zeros, outer = io.BytesIO(), io.BytesIO()
    with zipfile.ZipFile(zeros, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("data", "w") as member:
        for _ in range(200):
            member.write(bytes(2**20))
    yield zeros.getvalue()
    with zipfile.ZipFile(outer, "w", zipfile.ZIP_DEFLATED) as archive:
        for i in range(100):
            archive.writestr(f"{i}.zip", zeros.getvalue())
    yield outer.getvalue()


def climbers() -> Iterator[bytes]:
    """Archives whose members' paths lead out of where they are unpacked."""
    paths = ["../evil", "../../evil", "/tmp/tb2rl-evil", "policy/../../../evil", "..\\..\\evil"]
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for path in paths:
            archive.writestr(path, "evil")
    yield file.getvalue()
    for mode in ("w", "w:gz"):
        file = io.BytesIO()
        with tarfile.open(fileobj=file, mode=mode) as archive:
            for path in paths:
                archive.addfile(tarfile.TarInfo(path))
            link = tarfile.TarInfo("link")
            link.type, link.linkname = tarfile.SYMTYPE, "../.."
            archive.addfile(link)
        yield file.getvalue()


@pytest.mark.parametrize("name", ["policy.safetensors", "policy.zip"])
def test_an_archive_is_refused_and_nothing_is_unpacked(name, runs, refused, tmp_path):
    for i, content in enumerate([*bombs(), *climbers()]):
        inner = tmp_path / str(i) / "inner"
        run = Run.open(shutil.copytree(runs / "qlearn", inner / "run"))
        (inner / name).write_bytes(content)
        run.checkpoints[0].write_bytes(content)
        before = sorted(tmp_path.rglob("*"))
        for attempt, place in ((load, inner / name), (load, run.folder), (resume, run.folder)):
            used, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
            assert "is not a checkpoint" in refused(attempt, place)
            assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - used < 50_000  # KiB
            assert time.monotonic() - started < 2
        assert sorted(tmp_path.rglob("*")) == before

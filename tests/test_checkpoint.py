"""A checkpoint may come from anybody: reading one runs nothing, writes nothing, and ends in a policy or in one line.

The damaged files are tried in a process of their own, so that one of them may hang, crash or ask for all memory without
taking the tests along: this file is also the program of that process (see `main`).
"""

from __future__ import annotations

import base64
import errno
import faulthandler
import io
import json
import os
import pickle
import random
import resource
import shutil
import subprocess
import sys
import tarfile
import threading
import time
import zipfile
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.save_util import load_from_zip_file

from tb2rl import load
from tb2rl.callbacks import Checkpoints
from tb2rl.checkpoint import read_checkpoint, write_checkpoint
from tb2rl.config import resolve
from tb2rl.errors import InputError
from tb2rl.runs import Run
from tb2rl.training import resume, train_config

AGENTS = {
    "qlearn": {"task.edges": [0.7, 1.0]},
    "dqn": {
        "agent.learning_starts": 64,
        "agent.buffer_size": 320,
        "agent.batch_size": 16,
        "agent.gradient_steps": 1,
        "agent.policy_kwargs.net_arch": [16],
    },
    "ppo": {"agent.n_steps": 8, "agent.batch_size": 32, "agent.n_epochs": 1, "agent.policy_kwargs.net_arch": [16]},
}
TRAIN = {"simulation": "kinematic", "n_envs": 8, "total_timesteps": 256, "save_freq": 128, "keep": 9, "eval_freq": 0}
CASES = 600  # of damage at random
ROOM = 2 * 2**30  # [bytes] of address space that a file may cost on top of a process that has loaded good ones
LONGEST = 10  # [s] that a file may take


@dataclass(frozen=True)
class Case:
    """One bad file."""

    name: str
    agent: str
    content: bytes
    resumes: bool = False  # whether it is also tried as the latest checkpoint of a run


class Payload:
    """What an attacker hides in a pickle: here it makes a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __reduce__(self) -> tuple[Callable, tuple[str]]:
        return os.mkdir, (str(self.folder),)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A folder with a run of each agent that was killed after its first checkpoint."""
    folder = tmp_path_factory.mktemp("runs")
    for agent, settings in AGENTS.items():
        config = resolve(agent, settings={f"train.{key}": value for key, value in TRAIN.items()} | settings)
        run = train_config(config, folder / agent).run
        for file in run.checkpoints[:-1]:
            file.unlink()
        shutil.rmtree(run.folder / "tensorboard")
        shutil.rmtree(run.folder / "final")
    return folder


def checkpoint_of(runs: Path, agent: str) -> Path:
    return Run.open(runs / agent).checkpoints[-1]


# ---- pickles


def pickled_things(marker: Path) -> Iterator[tuple[str, str, bytes]]:
    """Whole files that run something in a reader that trusts them: name, suffix, content."""
    payload = Payload(marker)
    for protocol in (0, 2, 4):
        yield f"pickle {protocol}", ".pkl", pickle.dumps(payload, protocol)
    for new_format in (True, False):
        file = io.BytesIO()
        th.save({"policy": payload}, file, _use_new_zipfile_serialization=new_format)
        yield f"torch.save {new_format}", ".pt", file.getvalue()
    yield "SB3 zip, data", ".zip", stable_baselines_zip(pickle.dumps(payload), {"policy": {}})
    yield "SB3 zip, parameters", ".zip", stable_baselines_zip(pickle.dumps(1), {"policy": payload})
    file = io.BytesIO()
    np.save(file, np.array([payload], dtype=object), allow_pickle=True)
    yield "npy", ".npy", file.getvalue()
    file = io.BytesIO()
    np.savez(file, q=np.array([payload], dtype=object))
    yield "npz", ".npz", file.getvalue()


def stable_baselines_zip(data: bytes, parameters: dict[str, Any]) -> bytes:
    file, tensors = io.BytesIO(), io.BytesIO()
    th.save(parameters, tensors)
    entry = {":type:": "<class 'dict'>", ":serialized:": base64.b64encode(data).decode()}
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", json.dumps({"policy_class": entry}))
        archive.writestr("policy.pth", tensors.getvalue())
        archive.writestr("_stable_baselines3_version", "2.0.0")
    return file.getvalue()


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_the_payload_works(protocol, tmp_path):
    pickle.loads(pickle.dumps(Payload(tmp_path / "executed"), protocol))
    assert (tmp_path / "executed").is_dir()


def test_the_payloads_in_files_work(tmp_path):
    for name, suffix, content in pickled_things(tmp_path / "executed"):
        file = tmp_path / f"file{suffix}"
        file.write_bytes(content)
        with suppress(Exception):  # what it makes of the folder that it gets is another matter
            {
                ".pkl": lambda file: pickle.loads(file.read_bytes()),
                ".pt": lambda file: th.load(file, weights_only=False),
                ".npy": lambda file: np.load(file, allow_pickle=True),
                ".npz": lambda file: np.load(file, allow_pickle=True)["q"],
                ".zip": load_trusting,
            }[suffix](file)
        assert (tmp_path / "executed").is_dir(), name
        (tmp_path / "executed").rmdir()


def load_trusting(file: Path) -> None:
    """As Stable-Baselines3 did before torch read weights only."""
    with suppress(pickle.UnpicklingError):  # the tensors
        load_from_zip_file(file)
    with zipfile.ZipFile(file) as archive:
        th.load(io.BytesIO(archive.read("policy.pth")), weights_only=False)


@pytest.mark.slow
@pytest.mark.parametrize("agent", AGENTS)
def test_a_pickle_in_any_place_of_a_checkpoint_runs_nothing(agent, runs, tmp_path):
    report = tried(runs, f"pickles {agent}", tmp_path)
    assert len(report) > 100
    assert [line for line in report if line["executed"]] == []
    assert failures(report) == []


def test_a_file_that_is_a_pickle_runs_nothing(runs, tmp_path):
    run = shutil.copytree(runs / "dqn", tmp_path / "run")
    for name, suffix, content in pickled_things(tmp_path / "executed"):
        for file in (tmp_path / f"policy{suffix}", tmp_path / "policy.safetensors", checkpoint_of(tmp_path, "run")):
            file.write_bytes(content)
            with pytest.raises(InputError, match="is not a checkpoint"):
                load(file)
        for attempt in (load, resume):
            with pytest.raises(InputError, match="is not a checkpoint"):
                attempt(run)
        assert not (tmp_path / "executed").exists(), name


def test_a_pickle_in_a_runs_config_runs_nothing(runs, tmp_path):
    shutil.copytree(runs / "qlearn", tmp_path / "run")
    config = tmp_path / "run" / "config.yaml"
    for tag in ("!!python/object/apply:os.mkdir", "!!python/object/new:os.mkdir", "!!python/name:os.mkdir"):
        config.write_text(f"agent: {tag} [{tmp_path / 'executed'}]\n")
        for attempt in (load, resume):
            with pytest.raises(InputError, match=r"config\.yaml is not"):
                attempt(tmp_path / "run")
    assert not (tmp_path / "executed").exists()


def pickles(runs: Path, agent: str, marker: Path) -> Iterator[Case]:
    """A pickle in every array's bytes, and in place of every value of the tree, as text or base64."""
    header, data = split(checkpoint_of(runs, agent).read_bytes())
    plain = pickle.dumps(Payload(marker), 2)
    for name, entry in arrays_of(header).items():
        first, last = entry["data_offsets"]
        inside = data[:first] + plain.ljust(last - first, b".")[: last - first] + data[last:]
        yield Case(f"in array {name}", agent, joined(header, inside), resumes=True)
        changed = {**header, name: {"dtype": "U8", "shape": [len(plain)], "data_offsets": [len(data), -1]}}
        yield Case(f"for array {name}", agent, packed(changed, {name: plain}, data), resumes=True)
    content = header_content(header)
    texts = [pickle.dumps(Payload(marker), 0).decode("latin-1"), base64.b64encode(plain).decode()]
    for i, path in enumerate(places(content)):
        yield Case(f"at {path}", agent, with_content(header, data, changed_at(content, path, texts[i % 2])), i % 3 == 0)


# ---- damage at random


@pytest.mark.parametrize("count", [60, pytest.param(CASES, marks=pytest.mark.slow)])
def test_a_damaged_checkpoint_works_or_is_refused_in_one_line(count, runs, tmp_path):
    report = tried(runs, f"damage {count}", tmp_path)
    assert len(report) >= count
    assert failures(report) == []
    assert sum(line["outcome"] == "refused" for line in report) > count / 2, "the damage is too small to see"


def damage(runs: Path, count: int) -> Iterator[Case]:
    files = {agent: checkpoint_of(runs, agent).read_bytes() for agent in AGENTS}
    for i in range(count):
        rng = random.Random(i)
        how = rng.choices(list(DAMAGES), weights=[weight for _, weight in DAMAGES.values()])[0]
        agent = rng.choice(list(AGENTS))
        yield Case(f"{i}: {how}", agent, DAMAGES[how][0](rng, agent, files), resumes=i % 2 == 0)


def flipped(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    content = bytearray(files[agent])
    until = 8 + int.from_bytes(content[:8], "little") if rng.random() < 0.5 else len(content)
    for _ in range(rng.choice([1, 1, 2, 10, 100])):
        content[rng.randrange(until)] ^= 1 << rng.randrange(8)
    return bytes(content)


def flipped_data(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    """All bits of one small array at random: numbers that are out of every range."""
    header, data = split(files[agent])
    entries = list(arrays_of(header).values())
    first, last = rng.choice(entries)["data_offsets"]
    return joined(header, data[:first] + rng.randbytes(last - first) + data[last:])


def truncated(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    return files[agent][: rng.randrange(len(files[agent]))]


def lengthened(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    return files[agent] + rng.randbytes(rng.choice([1, 8, 1000]))


def header_length(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    true = int.from_bytes(files[agent][:8], "little")
    lies = [0, 1, 2, true - 1, true + 1, true + 8, 10**6, 10**8, 2**31, 2**32, 2**63 - 1, 2**63, 2**64 - 1]
    return rng.choice(lies).to_bytes(8, "little") + files[agent][8:]


def array_kind(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    """A lie about an array's type or shape, some with as many bytes as before."""
    header, data = split(files[agent])
    entry = arrays_of(header)[rng.choice(list(arrays_of(header)))]
    count = (entry["data_offsets"][1] - entry["data_offsets"][0]) or 1
    lies = [
        {"dtype": "U8", "shape": [count]},
        {"dtype": "I8", "shape": [1, count]},
        {"dtype": "BOOL", "shape": [count]},
        {"dtype": "F8_E4M3", "shape": [count]},
        {"dtype": "F8_E5M2", "shape": [count]},
        {"dtype": "F8_E8M0", "shape": [count]},
        {"dtype": "F4", "shape": [2 * count]},
        {"dtype": "BF16", "shape": [count // 2]},
        {"dtype": "F16", "shape": [count // 2]},
        {"dtype": "U16", "shape": [count // 2]},
        {"dtype": "I32", "shape": [count // 4]},
        {"dtype": "F32", "shape": [count // 4]},
        {"dtype": "U64", "shape": [count // 8]},
        {"dtype": "I64", "shape": [count // 8]},
        {"dtype": "F64", "shape": [1, 1, count // 8]},
        {"dtype": "C64", "shape": [count // 8]},
        {"dtype": rng.choice(["", "O", "F128", None, 3])},
        {"shape": rng.choice([[], [0], [10**12], [2**63, 2], [2**64], [-1], [1.5], None, "3", [1] * 100, [10**9] * 9])},
        {"shape": entry["shape"][::-1]},
        {"shape": [*entry["shape"], 1]},
        {"data_offsets": rng.choice([[0, 0], [0, 2**63], [8, 0], [-1, 8], [0], None])},
    ]
    entry.update(rng.choice(lies))
    return joined(header, data)


def array_emptied(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    """An array without elements, and without the bytes it had."""
    header, data = split(files[agent])
    name = rng.choice(list(arrays_of(header)))
    dtype = rng.choice([header[name]["dtype"], "U8", "F64"])
    shape = rng.choice([[0], [0, 3], [3, 0], [8, 0], [0, 10**12], [0, 2**62, 2**62]])
    return packed({**header, name: {"dtype": dtype, "shape": shape}}, {name: b""}, data)


def array_dropped(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    header, data = split(files[agent])
    name = rng.choice(list(arrays_of(header)))
    kept = {key: value for key, value in header.items() if key != name}
    return packed(kept, {}, data) if rng.random() < 0.7 else joined(kept, data)


def arrays_swapped(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    """Two arrays of one file trade places."""
    header, data = split(files[agent])
    one, other = rng.sample(list(arrays_of(header)), 2)
    return joined({**header, one: header[other], other: header[one]}, data)


def arrays_of_another(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    """The tree of one agent over the arrays of another, or a branch of the other's tree."""
    other = rng.choice([name for name in AGENTS if name != agent])
    (header, _), (others, data) = split(files[agent]), split(files[other])
    if rng.random() < 0.3:
        return joined({**others, "__metadata__": header["__metadata__"]}, data)
    mine, theirs = header_content(header), header_content(others)
    branch = rng.choice([("policy",), ("config",), ("training",), *(("training", key) for key in theirs["training"])])
    return with_content(others, data, changed_at(theirs, branch, at(mine, branch)))


def value_replaced(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    header, data = split(files[agent])
    content = header_content(header)
    for _ in range(rng.choice([1, 1, 1, 3])):
        content = changed_at(content, some_place(rng, content), bad_value(rng))
    return with_content(header, data, content)


def value_edited(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    """A number becomes another number, a string another string."""
    header, data = split(files[agent])
    content = header_content(header)
    path = some_place(rng, content)
    value = at(content, path)
    if isinstance(value, bool) or value is None:
        value = not value
    elif isinstance(value, int | float):
        value = rng.choice([-value, value + 1, value - 1, value * 10, value * 10**12, value / 3, 0, 2**32, 2**64])
    elif isinstance(value, str):
        value = rng.choice([value[1:], value + "x", value.upper(), value + ":x", value + "\n", "../" + value])
    elif isinstance(value, list):
        value = rng.choice([value[1:], value[::-1], [*value, *value], [value], [*value, None]])
    else:
        value = rng.choice([[value], {**value, "more": 1}, {**value, "": {}}, list(value), list(value.values())])
    return with_content(header, data, changed_at(content, path, value))


def value_dropped(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    header, data = split(files[agent])
    content = header_content(header)
    *path, key = some_place(rng, content)
    del at(content, path)[key]
    return with_content(header, data, content)


def tree_text(rng: random.Random, agent: str, files: dict[str, bytes]) -> bytes:
    """Something else than our JSON in the header."""
    header, data = split(files[agent])
    deep = rng.choice([100, 500, 990, 2_000, 100_000])
    texts = [
        "",
        "null",
        "[]",
        '"x"',
        "{",
        "1e999",
        "NaN",
        '{"format": 2}',
        '{"format": 2, "content": null}',
        '{"format": 2, "content": []}',
        '{"format": 2, "content": {"$array": "0"}}',
        '{"format": 2, "content": {"$pairs": [[[], 1]]}}',
        '{"format": 2, "content": {"$pairs": [[{}, 1], 3]}}',
        '{"format": 2, "content": {"$pairs": 3}}',
        '{"format": 2.0, "content": {}}',
        '{"format": [2], "content": {}}',
        '{"format": "2\\n\\n", "content": {}}',
        '{"format": ' + "9" * 5000 + ', "content": {}}',
        '{"format": 2, "content": ' + "[" * deep + "]" * deep + "}",
        '{"format": 2, "content": ' + '{"a": ' * deep + "1" + "}" * deep + "}",
        '{"format": ' + "[" * deep + "]" * deep + ', "content": {}}',
        '{"format": 2, "content": [' + "[]," * 10**6 + "1]}",
        "x" * 10**6,
    ]
    return joined({**header, "__metadata__": rng.choice([{"tb2rl": rng.choice(texts)}, {"tb2rl": 3}, {}, None])}, data)


DAMAGES: dict[str, tuple[Callable[[random.Random, str, dict[str, bytes]], bytes], int]] = {
    "flipped": (flipped, 4),
    "flipped data": (flipped_data, 3),
    "truncated": (truncated, 2),
    "lengthened": (lengthened, 1),
    "header length": (header_length, 2),
    "array kind": (array_kind, 6),
    "array emptied": (array_emptied, 3),
    "array dropped": (array_dropped, 2),
    "arrays swapped": (arrays_swapped, 3),
    "arrays of another": (arrays_of_another, 3),
    "value replaced": (value_replaced, 12),
    "value edited": (value_edited, 6),
    "value dropped": (value_dropped, 6),
    "tree text": (tree_text, 3),
}


def bad_value(rng: random.Random) -> Any:
    nested: Any = 1
    for i in range(rng.choice([3, 50, 300])):
        nested = [nested] if i % 2 else {"a": nested}
    values = [
        None,
        True,
        False,
        0,
        -1,
        1,
        0.5,
        -0.0,
        1e308,
        float("nan"),
        float("inf"),
        float("-inf"),
        10**9,
        -(10**18),
    ]
    values += [10**30, -(10**400), 2**63, 2**64, [], {}, [[]], [None], {"a": 1}, {"": None}, "", "0", "\0", "a\nb", "ü"]
    values += [":", "os:system", "no.such.module:X", "torch:load", "torch.nn:Linear", "../../etc/passwd", "/etc/passwd"]
    values += ["x" * 300, "x" * 10**5, [0] * 10**4, {"$array": "0"}, {"$array": "none"}, {"$array": 0}, {"$pairs": []}]
    values += [{"$pairs": [[None, 1], [0, 2]]}, {"start": 1.0, "end": 0.0}, nested, nested]
    return rng.choice(values)


# ---- lies that cost memory or time, and those that a reader might believe


@pytest.mark.slow
def test_what_a_config_claims_costs_no_memory_nor_time(runs, tmp_path):
    assert failures(tried(runs, "claims", tmp_path)) == []


CLAIMS: dict[str, list[Any]] = {
    "train.n_envs": [10**6, 10**9, 10**18, 2**63, 10**30],
    "train.seed": [2**32, 10**18, 10**30],
    "train.device": ["cuda", "cuda:99", "meta", "mps", "nowhere", "", "cpu:7"],
    "train.total_timesteps": [10**30],
    "train.torch_threads": [10**9],
    "task.beams": [10**7, 10**9, 10**12, 2**63, 10**30],
    "task.kept": [[10**12], [0] * 10**6, [2**63]],
    "task.edges": [[float(i + 1) for i in range(10**4)], [1e-320, 1e308]],
    "task.episode_steps": [10**30],
    "task.control_period": [1e-320, 1e308],
    "task.start_clearance": [1e6, 1e308],
    "task.maze": ["", "\0", ".", "..", "/", "/dev/zero", "/etc/passwd", "x.yaml", "x" * 300 + ".yaml", "a/" * 5000],
    "task.name": ["", ":", "os:mkdir", "tb2rl.tasks:Task", "tb2rl.tasks.wander:Wander", "asyncio.windows_events:X"],
    "task.observation": ["", "discrete", "raw", "x" * 10**6],
    "agent.name": [
        "random", "wallfollower", "qlearn", "dqn", "ppo", "stable_baselines3:A2C", "stable_baselines3:SAC", ":", "::",
        "stable_baselines3.common.base_class:BaseAlgorithm",
        "stable_baselines3.common.off_policy_algorithm:OffPolicyAlgorithm",
        "os:mkdir", "torch:load", "sys:modules", "tb2rl.agents.dqn:AGENT", "a:b:c", "..:x", "x" * 10**6, "dqn\nppo",
        "asyncio.windows_events:X", "multiprocessing.popen_spawn_win32:Popen", "unittest.__main__:main",
    ],
    "agent.buffer_size": [10**8, 10**9, 10**12, 10**18, 10**30, 1, 0, -1],
    "agent.batch_size": [10**12, 10**30, 0, -1],
    "agent.n_steps": [10**9, 10**12, 10**30, 0, -1],
    "agent.n_epochs": [10**30, -1],
    "agent.gamma": [1e308, -1e308],
    "agent.learning_rate": [1e308, -1.0, {"start": 1.0}, {"start": 1.0, "end": 0.0, "fraction": 0}],
    "agent.stats_window_size": [10**9, 10**30, 0, -1],
    "agent.train_freq": [0, -1, 10**30, [1, "episode"], [1, "x"], [1], []],
    "agent.gradient_steps": [10**30, -5],
    "agent.target_update_interval": [0, -1, 10**30],
    "agent.replay_buffer_class": ["stable_baselines3:HerReplayBuffer", "os:mkdir"],
    "agent.replay_buffer_kwargs": [{"x": 1}, {"optimize_memory_usage": True}],
    "agent.optimize_memory_usage": [True],
    "agent.use_sde": [True],
    "agent.exploration_fraction": [0.0, -1.0],
    "agent.policy_kwargs": [None, 3, [], {"x": 1}, {"": 1}, {"lr_schedule": 1}, {"initial_value": "x"}],
    "agent.policy_kwargs.net_arch": [
        [10**6, 10**6], [20_000] * 3, [10**9], [10**18], [2**63], [10**30], [8] * 10**4, [0], [-1], [0.5], ["x"], [[8]],
        "x", 3, {"pi": [10**6, 10**6], "vf": [8]}, {"x": [8]}, {"pi": 3, "vf": None},
    ],
    "agent.policy_kwargs.activation_fn": ["torch.nn:ReLU", "torch.nn:Linear", "torch.nn:Module", "ReLU", 3],
    "agent.policy_kwargs.features_extractor_class": ["torch.nn:Linear", "torch.nn:Module", "torch:load"],
    "agent.policy_kwargs.features_extractor_kwargs": [{"x": 1}, {"middle": "x"}, {"offset": None}, []],
    "agent.policy_kwargs.optimizer_class": ["torch.optim:LBFGS", "torch.nn:Linear", "torch:load", "x"],
    "agent.policy_kwargs.optimizer_kwargs": [{"x": 1}, {"lr": "x"}, {"betas": 3}, {"eps": -1}, 3],
    "agent.policy_kwargs.normalize_images": ["x"],
    "agent.policy_kwargs.ortho_init": ["x"],
}  # fmt: skip


def claims(runs: Path) -> Iterator[Case]:
    """A config that claims what it likes, over true arrays."""
    for agent in AGENTS:
        header, data = split(checkpoint_of(runs, agent).read_bytes())
        content = header_content(header)
        for key, values in CLAIMS.items():
            for value in values:
                changed = deepcopy(content)
                *branch, last = key.split(".")
                place = changed["config"]
                for name in branch:
                    place = place.setdefault(name, {})
                place[last] = value
                yield Case(f"{key}={value!r}"[:80], agent, with_content(header, data, changed))


@pytest.mark.slow
def test_what_a_state_claims_is_refused_or_goes_on(runs, tmp_path):
    assert failures(tried(runs, "states", tmp_path)) == []


STATES: dict[str, list[Any]] = {
    "timesteps": [-1, -(10**18), 10**30, 0, True, 1.5, "128", None],
    "training": [None, [], {}, "x"],
    "training/optimizers": [None, [], {}, {"x": {}}, {"policy": {}}, {"policy.optimizer": {}}, {"env": {}}],
    "training/optimizers/policy.optimizer/param_groups/0/lr": [None, "x", -1.0, float("nan"), 10**400, []],
    "training/optimizers/policy.optimizer/param_groups/0/betas": [None, "x", [], [2.0, 2.0], 3],
    "training/optimizers/policy.optimizer/param_groups/0/eps": [None, "x", []],
    "training/optimizers/policy.optimizer/param_groups/0/params": [[], [0], [0, 0, 0, 0], "0123", [10**30]],
    "training/optimizers/policy.optimizer/param_groups/0/fused": [True, "x"],
    "training/optimizers/policy.optimizer/param_groups": [None, [], [{}]],
    "training/optimizers/policy.optimizer/state": [None, [], {"0": {}}, {"$pairs": [[0, {}]]}, {"$pairs": [[0, 3]]}],
    "training/algorithm/num_timesteps": [-(10**18), 10**18, "x", 0.5, float("nan")],
    "training/algorithm/_episode_num": [-1, 10**30, float("nan"), 0.5],
    "training/algorithm/_n_updates": [-1, 10**30, float("nan"), 0.5],
    "training/algorithm/_n_calls": [-1, 10**30, float("nan"), 0.5],
    "training/algorithm/exploration_rate": [float("nan"), -1, 10**400, True],
    "training/algorithm/_current_progress_remaining": [float("nan"), -(10**18), 10**400],
    "training/algorithm/gamma": [float("nan"), 10**400],
    "training/algorithm/batch_size": [10**12, 0, -1, 0.5],
    "training/algorithm/n_steps": [10**12, 0, -1, 0.5],
    "training/algorithm/n_epochs": [10**12, 0, -1, 0.5],
    "training/algorithm/buffer_size": [10**12, 0, -1],
    "training/algorithm/gradient_steps": [10**12, -1, 0.5],
    "training/algorithm/learning_starts": [10**30, -1],
    "training/algorithm/target_update_interval": [0, -1],
    "training/algorithm/_stats_window_size": [-1, 10**30, 0.5],
    "training/algorithm/_logged_at": [-1, 10**30],
    "training/algorithm/ep_info_buffer": [[1], [{}], ["x"], [{"r": "x", "l": None}], [{"r": float("nan")}], {}],
    "training/algorithm/ep_success_buffer": [["x"], [{}], [[]]],
    "training/algorithm/_last_obs": [{"$array": "0"}, [], None, 3],
    "training/algorithm/_last_episode_starts": [{"$array": "0"}, [], None],
    "training/algorithm/_custom": [1, [1], {"$array": "0"}, "x"],
    "training/algorithm/policy": [1, [1], {"$array": "0"}],
    "training/algorithm/learn": [1, [1], {"$array": "0"}],
    "training/replay_buffer": [None, {}, [], {"pos": 1}],
    "training/replay_buffer/pos": [10**12, -1, -(10**12), 0.5, 39, 40, 41],
    "training/replay_buffer/full": [True, 3, -1],
    "training/replay_buffer/buffer_size": [10**12, 0, -1, 1],
    "training/replay_buffer/n_envs": [10**12, 0, 1],
    "training/replay_buffer/action_dim": [10**12, 0],
    "training/replay_buffer/n_steps": [10**12, 0, -1],
    "training/replay_buffer/gamma": [float("nan"), 10**400],
    "training/replay_buffer/observations": [None, {"$array": "0"}, []],
    "training/generators/python/0": [2, 4, None, "x"],
    "training/generators/python/1": [[], [0] * 625, [-1] * 625, [2**64] * 625, "x"],
    "training/generators/python/2": ["x", 0.5, []],
    "training/generators/numpy": [None, {}, [], "x"],
    "training/generators/torch": [{"$array": "0"}, None, []],
    "training/generators/actions": [None, {}, {"bit_generator": "MT19937"}],
    "training/generators/own": [None, {}, {"bit_generator": "MT19937"}],
    "training/worlds": [None, [], {}, "x"],
    "training/worlds/reading/ranges": [{"$array": "0"}, None, []],
    "training/worlds/generator": [None, {}],
    "training/callbacks": [None, [], [{}], [{}, {}], [1, 2]],
    "training/callbacks/0/lengths": [None, "x", [None], [{}], [10**400] * 3, {"a": 1}],
    "training/callbacks/0/ended": [[1], "crash", [[]], None],
    "training/callbacks/0/distances": [["x"], [None], [[]], [10**400], None],
    "training/callbacks/1/next": [10**400, float("nan"), -1, "x", None, float("inf")],
}  # fmt: skip


def states(runs: Path) -> Iterator[Case]:
    """The state of a training that claims what it likes, and each of its arrays with another type, shape or content."""
    for agent in AGENTS:
        header, data = split(checkpoint_of(runs, agent).read_bytes())
        content = header_content(header)
        for place, values in STATES.items():
            path = [int(key) if key.isdigit() else key for key in place.split("/")]
            for value in values:
                with suppress(KeyError, IndexError, TypeError):  # another agent's
                    changed = changed_at(content, path, value)
                    yield Case(f"{place}={value!r}"[:90], agent, with_content(header, data, changed), resumes=True)
        for path in places(content):
            if path[0] == "training" and path[-1] == "$array":
                yield from strange_arrays(agent, header, data, path, at(content, path))


KINDS = {"F32": "float32", "F64": "float64", "I64": "int64", "U32": "uint32", "U64": "uint64"}
KINDS |= {"BOOL": "bool", "U8": "uint8"}


def strange_arrays(agent: str, header: dict[str, Any], data: bytes, path: list[Any], name: str) -> Iterator[Case]:
    entry, place = header[name], "/".join(map(str, path[1:-1]))
    first, last = entry["data_offsets"]
    array = np.frombuffer(data[first:last], KINDS[entry["dtype"]]).reshape(entry["shape"])
    if array.dtype.kind == "f":
        others = [np.full_like(array, value) for value in (np.nan, np.inf, -np.inf, np.finfo(array.dtype).max)]
    else:
        extremes = (0, 1) if array.dtype.kind == "b" else (np.iinfo(array.dtype).min, np.iinfo(array.dtype).max)
        others = [np.full_like(array, value) for value in extremes]
    others += [array.astype(np.float32), array.astype(np.int64), array.astype(bool), array.astype(np.uint8)]
    others += [array[..., None], array[None], array.ravel(), array.reshape(-1)[:0], array.reshape(-1)[0:1].reshape(())]
    others += [array[:-1], np.repeat(array, 2, axis=0)] if array.ndim else []
    others += [array[:, :0], array[:, :-1]] if array.ndim > 1 else []
    kinds = {numpy: name for name, numpy in KINDS.items()}
    for other in others:
        changed = {**header, name: {"dtype": kinds[other.dtype.name], "shape": list(other.shape)}}
        shown = f"{place}: {other.dtype} {other.shape} {other.reshape(-1)[:1]}"
        yield Case(shown, agent, packed(changed, {name: other.tobytes()}, data), resumes=True)


# ---- archives


@pytest.mark.parametrize("name", ["policy.safetensors", "policy.zip"])
def test_an_archive_is_refused_and_nothing_is_unpacked(name, runs, tmp_path):
    for i, content in enumerate([*bombs(), *climbers()]):
        inner = tmp_path / str(i) / "inner"
        run = shutil.copytree(runs / "qlearn", inner / "run")
        (inner / name).write_bytes(content)
        checkpoint_of(inner, "run").write_bytes(content)
        before = sorted(tmp_path.rglob("*"))
        for attempt, place in ((load, inner / name), (load, run), (resume, run)):
            used, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
            with pytest.raises(InputError, match="is not a checkpoint") as refused:
                attempt(place)
            assert len(str(refused.value).splitlines()) == 1
            assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - used < 50_000  # KiB
            assert time.monotonic() - started < 2
        assert sorted(tmp_path.rglob("*")) == before


def bombs() -> Iterator[bytes]:
    """Zips whose one member is 200 MB of zeros: alone, and one within the other."""
    zeros = io.BytesIO()
    with zipfile.ZipFile(zeros, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("data", "w") as member:
        for _ in range(200):
            member.write(bytes(2**20))
    yield zeros.getvalue()
    outer = io.BytesIO()
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


# ---- round trips

ARRAY_TYPES = ["bool", "uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64"]
ARRAY_TYPES += ["float16", "float32", "float64"]


def round_trip(tree: dict[str, Any], folder: Path) -> dict[str, Any]:
    write_checkpoint(folder / "tree.safetensors", tree)
    return read_checkpoint(folder / "tree.safetensors")


@pytest.mark.parametrize(
    "value",
    [
        *(None, True, False, 0, -1, 2**31, 2**63, 2**64, -(2**127), 10**300, 0.1, -0.0, 1e-320, 1.7e308),
        *(float("inf"), float("-inf"), "", "x", "ü\0\n\\\"'", "\ud800", "$array", "$pairs", "NaN", [], {}, [[]], [{}]),
        *([None, [True, {"a": []}]], {"a": {"b": {"c": {"": 1}}}}, {1: {2: {-3: None}}}, {0: "a", 1: {"b": [{2: 3}]}}),
        *({"$array": "0"}, {"$pairs": [[1, 2]]}, {"$pairs": {"$array": 3}}, {"$": 1, "a": {"$array": None}}, {"1": 1}),
        *({1: "int", "1": "str"}, {None: 1, 1.5: 2}, {"format": 7, "content": 8, "tb2rl": 9, "__metadata__": 10}),
    ],
    ids=lambda value: repr(value)[:40],
)
def test_plain_values_come_back(value, tmp_path):
    found = round_trip({"value": value}, tmp_path)["value"]
    assert same(found, value), found


def test_nan_comes_back(tmp_path):
    assert np.isnan(round_trip({"value": float("nan")}, tmp_path)["value"])


def test_other_sequences_come_back_as_lists(tmp_path):
    tree = {"tuple": (1, (2, 3)), "deque": deque([1.5, {"r": 1}]), "numbers": [np.float32(0.5), np.int64(3), np.True_]}
    found = round_trip(tree, tmp_path)
    assert found == {"tuple": [1, [2, 3]], "deque": [1.5, {"r": 1}], "numbers": [0.5, 3, True]}
    assert [type(number) for number in found["numbers"]] == [float, int, bool]


@pytest.mark.parametrize("shape", [(), (1,), (0,), (3, 0, 2), (2, 3, 4), (1, 1, 1, 1, 1, 1)], ids=str)
@pytest.mark.parametrize("dtype", ARRAY_TYPES)
def test_arrays_come_back(dtype, shape, tmp_path):
    bits = np.random.default_rng(0).integers(0, 2 if dtype == "bool" else 256, size=(*shape, 8), dtype=np.uint8)
    array = bits.view(dtype)[..., 0]
    tree = {"array": array, "list": [array, {5: array}], "tensor": th.from_numpy(array.copy())}
    found = round_trip(tree, tmp_path)
    for one in (found["array"], *found["list"][:1], found["list"][1][5], found["tensor"]):
        assert (type(one), one.dtype, one.shape) == (np.ndarray, array.dtype, shape)
        assert one.tobytes() == array.tobytes(), "to the bit, whatever NaN it is"


def test_arrays_in_any_memory_layout_come_back(tmp_path):
    array = np.arange(24.0).reshape(2, 3, 4)
    views = {
        "turned": array.T,
        "reversed": array[::-1],
        "strided": array[:, ::2, 1::2],
        "wide": np.broadcast_to(1.0, (3, 2)),
    }
    views["fortran"] = np.asfortranarray(array)
    found = round_trip({**views, "tensor": th.ones(3, 4, requires_grad=True).T}, tmp_path)
    for name, view in views.items():
        np.testing.assert_array_equal(found[name], view)
    assert found["tensor"].shape == (4, 3)


def test_what_comes_back_can_be_changed(tmp_path):
    found = round_trip({"array": np.zeros(3)}, tmp_path)["array"]
    found += 1
    assert found.tolist() == [1, 1, 1]
    assert read_checkpoint(tmp_path / "tree.safetensors")["array"].tolist() == [0, 0, 0]


@pytest.mark.parametrize("agent", AGENTS)
def test_a_real_checkpoint_comes_back_to_the_byte(agent, runs, tmp_path):
    file = checkpoint_of(runs, agent)
    write_checkpoint(tmp_path / "again.safetensors", read_checkpoint(file))
    assert (tmp_path / "again.safetensors").read_bytes() == file.read_bytes()


def same(one: Any, other: Any) -> bool:
    """Equal in value and type, all the way down."""
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    return repr(one) == repr(other)


# ---- writes that fail


def no_space(*_: Any, **__: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("function", ["fsync", "replace"])
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(function, monkeypatch, tmp_path):
    file = tmp_path / "tree.safetensors"
    write_checkpoint(file, {"a": np.ones(3)})
    before = file.read_bytes()
    monkeypatch.setattr(os, function, no_space)
    with pytest.raises(OSError, match="No space left"):
        write_checkpoint(file, {"a": np.zeros(3000)})
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]


def test_a_disk_that_is_full_midway_leaves_the_old_file_and_nothing_else(tmp_path):
    """A real write error: no file of the process may grow beyond 100 kB."""
    program = """
import resource, signal, sys, numpy as np
from pathlib import Path
from tb2rl.checkpoint import write_checkpoint
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
write_checkpoint(Path(sys.argv[1]), {"a": np.ones(3)})
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
try:
    write_checkpoint(Path(sys.argv[1]), {"a": np.zeros(10**6)})
except OSError as error:
    print(type(error).__name__)
"""
    file = tmp_path / "tree.safetensors"
    arguments = [sys.executable, "-c", program, str(file)]
    assert subprocess.run(arguments, capture_output=True, text=True, check=True).stdout == "OSError\n"
    assert read_checkpoint(file)["a"].tolist() == [1, 1, 1]
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("value", [object(), {1, 2, object()}, np.array([object()]), np.array(["x"]), np.array([1j])])
def test_what_cannot_be_written_leaves_the_old_file_and_nothing_else(value, tmp_path):
    file = tmp_path / "tree.safetensors"
    write_checkpoint(file, {"a": 1})
    with suppress(Exception):
        write_checkpoint(file, {"a": value})
    assert read_checkpoint(file)["a"] is not None
    assert list(tmp_path.iterdir()) == [file]


def test_a_write_over_a_folder_leaves_nothing_behind(tmp_path):
    (tmp_path / "tree.safetensors").mkdir()
    with pytest.raises(OSError, match="directory"):
        write_checkpoint(tmp_path / "tree.safetensors", {"a": 1})
    assert list(tmp_path.iterdir()) == [tmp_path / "tree.safetensors"]


def test_a_write_without_a_folder_fails_and_makes_none(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_checkpoint(tmp_path / "none" / "tree.safetensors", {"a": 1})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_write_into_a_folder_that_may_not_be_written_leaves_the_old_file(tmp_path):
    file = tmp_path / "tree.safetensors"
    write_checkpoint(file, {"a": 1})
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(PermissionError):
            write_checkpoint(file, {"a": 2})
        assert read_checkpoint(file) == {"a": 1}
        assert list(tmp_path.iterdir()) == [file]
    finally:
        tmp_path.chmod(0o700)


def test_a_run_that_cannot_save_says_so_in_one_line(runs, monkeypatch, tmp_path):
    run = Run.open(shutil.copytree(runs / "qlearn", tmp_path / "run"))
    algorithm = load(run.folder)
    before = {file: file.read_bytes() for file in run.folder.rglob("*") if file.is_file()}
    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(InputError, match=r"cannot write .*policy\.safetensors: No space left") as refused:
        run.save(algorithm, "final/policy")
    assert "\n" not in str(refused.value)
    assert {file: file.read_bytes() for file in run.folder.rglob("*") if file.is_file()} == before


# ---- speed


@pytest.mark.slow
def test_a_full_replay_buffer_is_saved_and_loaded_in_two_seconds(monkeypatch, tmp_path):
    rows, saving = 100_000, []
    save = Checkpoints.save

    def timed(self: Checkpoints) -> None:
        started = time.monotonic()
        save(self)
        saving.append(time.monotonic() - started)

    monkeypatch.setattr(Checkpoints, "save", timed)
    train = {**TRAIN, "n_envs": 250, "total_timesteps": rows, "save_freq": 0}
    settings = {"agent.buffer_size": rows, "agent.learning_starts": 10 * rows, "task.beams": 36}
    config = resolve("dqn", settings={f"train.{key}": value for key, value in train.items()} | settings)
    file = train_config(config, tmp_path / "run").run.checkpoints[0]
    started = time.monotonic()
    content = read_checkpoint(file)
    reading = time.monotonic() - started
    assert content["training"]["replay_buffer"]["observations"].shape == (rows // 250, 250, 36)
    started = time.monotonic()
    load(file)
    loading = time.monotonic() - started
    print(
        f"saved in {saving[0]:.2f} s, read in {reading:.2f} s, loaded in {loading:.2f} s, {file.stat().st_size} bytes"
    )
    assert max(*saving, reading, loading) <= 2


# ---- a file's header and tree


def split(content: bytes) -> tuple[dict[str, Any], bytes]:
    """The header and the data of a safetensors file."""
    length = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + length]), content[8 + length :]


def joined(header: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data


def packed(header: dict[str, Any], new: dict[str, bytes], data: bytes) -> bytes:
    """A file whose data is whole again: the arrays of the header in turn, some of them with new bytes."""
    made, parts, place = {"__metadata__": header["__metadata__"]}, [], 0
    for name, entry in arrays_of(header).items():
        part = new[name] if name in new else data[slice(*entry["data_offsets"])]
        made[name] = {**entry, "data_offsets": [place, place + len(part)]}
        parts.append(part)
        place += len(part)
    return joined(made, b"".join(parts))


def arrays_of(header: dict[str, Any]) -> dict[str, Any]:
    return {name: entry for name, entry in header.items() if name != "__metadata__"}


def header_content(header: dict[str, Any]) -> dict[str, Any]:
    """The tree in a header, with its references to arrays as they are."""
    return json.loads(header["__metadata__"]["tb2rl"])["content"]


def with_content(header: dict[str, Any], data: bytes, content: Any) -> bytes:
    text = json.dumps({"format": 2, "content": content})
    return joined({**header, "__metadata__": {"tb2rl": text}}, data)


def at(tree: Any, path: Any) -> Any:
    for key in path:
        tree = tree[key]
    return tree


def changed_at(tree: Any, path: Any, value: Any) -> Any:
    """A copy of the tree with another value at one place."""
    tree = deepcopy(tree)
    *branch, last = path
    at(tree, branch)[last] = value
    return tree


def children(tree: Any) -> list[Any]:
    return list(tree) if isinstance(tree, dict) else list(range(len(tree))) if isinstance(tree, list) else []


def places(tree: Any, longest: int = 4) -> Iterator[list[Any]]:
    """All places in a tree, of a long list only the first few."""
    for key in children(tree)[: longest if isinstance(tree, list) else None]:
        yield [key]
        for rest in places(tree[key], longest):
            yield [key, *rest]


def some_place(rng: random.Random, tree: Any) -> list[Any]:
    """One place, each branch as likely as its siblings: the state of a generator has thousands of numbers."""
    path: list[Any] = []
    while children(tree) and not (path and rng.random() < 0.15):
        path.append(rng.choice(children(tree)))
        tree = tree[path[-1]]
    return path


# ---- the process that tries bad files


def cases(runs: Path, family: str, marker: Path) -> Iterator[Case]:
    name, _, rest = family.partition(" ")
    if name == "pickles":
        return pickles(runs, rest, marker)
    if name == "damage":
        return damage(runs, int(rest))
    return claims(runs) if name == "claims" else states(runs)


def tried(runs: Path, family: str, folder: Path) -> list[dict[str, Any]]:
    """What became of every case of a family; a process that dies of one, or soon after, is followed by another."""
    lines, work = folder / "report.jsonl", folder / "work"
    report: list[dict[str, Any]] = []
    environment = {**os.environ, "MALLOC_ARENA_MAX": "2", "OMP_NUM_THREADS": "1"}
    while True:
        lines.write_text("")
        arguments = [sys.executable, __file__, str(runs), family, str(len(report)), str(work), str(lines)]
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


def main(runs: str, family: str, first: str, work: str, lines: str) -> None:
    """Try the cases of a family from number `first` on, a line of JSON before and after each."""
    faulthandler.enable()
    folder = Path(work)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for agent in AGENTS:  # what good ones need is not what bad ones cost
        shutil.copytree(Path(runs, agent), folder / agent)
        load(checkpoint_of(folder, agent))
        resume(folder / agent)
        shutil.rmtree(folder / agent)
    resource.setrlimit(resource.RLIMIT_AS, (address_space() + ROOM, resource.RLIM_INFINITY))
    with Path(lines).open("a", buffering=1) as report:
        for number, case in enumerate(
            islice(cases(Path(runs), family, folder / "executed"), int(first), None), int(first)
        ):
            about = {"number": number, "name": case.name, "agent": case.agent}
            report.write(json.dumps(about) + "\n")
            report.write(json.dumps({**about, **outcome(case, Path(runs), folder)}) + "\n")


def outcome(case: Case, runs: Path, folder: Path) -> dict[str, Any]:
    file = folder / "policy.safetensors"
    file.write_bytes(case.content)
    found = attempt(load, file)
    if case.resumes and found["outcome"] != "failed":
        run = shutil.copytree(runs / case.agent, folder / "run")
        checkpoint_of(folder, "run").write_bytes(case.content)
        found = {**attempt(resume, run), "attempt": "resume"}
        stop_writers()
        shutil.rmtree(run)
    executed = (folder / "executed").exists()
    if executed:
        (folder / "executed").rmdir()
    return {**found, "executed": executed}


def attempt(what: Callable[[Path], Any], path: Path) -> dict[str, Any]:
    """What comes of reading a file: it works, or is refused in one line that names it, else it failed."""
    started = time.monotonic()
    faulthandler.dump_traceback_later(LONGEST, exit=True)
    try:
        what(path)
        found = {"outcome": "works"}
    except InputError as error:
        clean = len(str(error).splitlines()) == 1 and str(path) in str(error)
        found = {"outcome": "refused" if clean else "failed", "error": f"InputError: {error}"}
    except BaseException as error:  # a panic of safetensors is no Exception
        found = {"outcome": "failed", "error": f"{type(error).__name__}: {error}", "where": where(error)}
    finally:
        faulthandler.cancel_dump_traceback_later()
    found["error"] = found.get("error", "")[:400]
    return {**found, "attempt": what.__name__, "seconds": round(time.monotonic() - started, 2)}


def stop_writers() -> None:
    """Stop the threads that write event files, which a training that failed leaves behind."""
    for thread in threading.enumerate():
        if hasattr(thread, "stop"):
            thread.stop()


def where(error: BaseException) -> list[str]:
    """The innermost lines that an exception came through."""
    trace, lines = error.__traceback__, []
    while trace:
        lines.append(f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}")
        trace = trace.tb_next
    return lines[-6:]


def address_space() -> int:
    """[bytes]"""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


if __name__ == "__main__":
    main(*sys.argv[1:])

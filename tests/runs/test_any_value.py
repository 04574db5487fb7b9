"""Any value of any key of a config trains, or is refused in one line that names the key or the file.

Daily a sample of values that are refused; with `-m fuzz` every key, in a process that may hang or exhaust memory.
"""

from __future__ import annotations

import dataclasses
import json
import pickle
import select
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from inspect import signature
from pathlib import Path
from typing import Any

import pytest
import torch as th
import yaml
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import TASKS, import_object
from tb2rl.envs.features import InverseRange
from tb2rl.runs.arguments import check_arguments
from tb2rl.runs.config import TrainSettings
from tb2rl.runs.layers import resolve
from tb2rl.tasks.registry import find_task
from tb2rl.training.training import train_config

NAN, INF = float("nan"), float("inf")
LINE = {"start": 0.1, "end": 0.1, "fraction": 1.0}
AGENTS = {  # small enough that eight steps reach every part of an algorithm
    "qlearn": {},
    "dqn": {"learning_starts": 2, "batch_size": 4, "buffer_size": 64},
    "ppo": {"n_steps": 4, "batch_size": 4, "n_epochs": 1},
}
TRAIN = {"simulation": "kinematic", "n_envs": 2, "eval_freq": 0, "save_freq": 0, "eval_episodes": 1, "eval_steps": 4}
SECONDS = 20.0  # that a few steps may take
CASES = 250  # of a process: leftovers of one case must not make another one fail

EXTREMES = (
    True, 0, 1, -1, 2**31, 2**63, 10**9, 10**12, 10**30, 10**400, 10**5000, 0.5, -0.5, 2.5, 5e-324, 1e30, 1e308, NAN,
    INF, -INF, "", " ", "a", "1", "auto", "epsilon", "None", "a\nb", "\0", "\ud800", "é🤖", "x" * 100_000, "..", "/",
    "no/such.yaml", "\0.yaml", "x" * 5000 + ".yaml", "cuda:99", "meta", "loop", "raw", ":", "a:b", "os:system",
    "torch.nn:ELU", "torch.nn:Linear", "torch.optim:SGD", "tb2rl.envs.features:InverseRange", "tb2rl.tasks:Task",
    "stable_baselines3:SAC", None, [], [[]], [-1], [2, 1], [10**6, 10**6], [1e308], [10**400], [NAN], ["a"], [None],
    [1] * 5000, [4, "step"], [10**12, "step"], {}, {"a": 1}, {1: 2}, {None: None}, {"": {}}, [1e308, 1e308], [{}], LINE,
    {**LINE, "start": 1e308}, {"start": 1}, {"pi": [4], "vf": [4]}, {"pi": [], "vf": 3}, date(2001, 1, 1), b"\xff",
)  # fmt: skip
YAMLS = (  # in place of a value
    "1" * 5000, "0x", "1:99", "1e400", "2001-99-99", "=", "<<", "!!int x", "!!timestamp x", "!!binary é",
    "!!python/name:os.system", "!!set {a}", "!x 1", "[" * 5000, "{a: " * 300 + "}" * 300, "&a [*a]", "*a",
    "{? [1] : 2}", "{<<: [1]}", "{a: 1, a: 2}", "\t", "@", "%", "'", '"\\ud800"', "\0", "\x7f", "\ufeff", "\ud800",
)  # fmt: skip
PLACES = ("{}", "agent: {{policy_kwargs: {}}}", "task: {{world: {}}}", "train: {{{}: 1}}")

_SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20)
_TREES = st.recursive(
    _SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5) | _SCALARS, inner, max_size=3),
    max_leaves=6,
)
VALUES = st.sampled_from(EXTREMES) | _TREES


@dataclass(frozen=True)
class Key:
    """A key of a training that is small otherwise."""

    agent: str
    task: str
    name: str

    def __str__(self) -> str:
        return f"{self.agent}-{self.task}-{self.name}"

    def case(self, value: Any, in_file: bool) -> dict[str, Any]:
        """The training with a value for this key, as `try_settings.py` takes it."""
        section, *path = self.name.split(".")
        named = [section, "cannot import"] if path == ["name"] else [*path, "mine.yaml"]
        who = {"agent": None if self.name == "agent.name" else self.agent}
        who |= {"task": None if self.name == "task.name" else self.task, "named": named}
        values = {**self._others(), self.name: value}
        if not in_file:
            return {**who, "settings": values}
        text = yaml.safe_dump(nested(values), allow_unicode=True)
        return {**who, "file": text.encode(errors="surrogatepass")}

    def _others(self) -> dict[str, Any]:
        small = {f"train.{key}": value for key, value in TRAIN.items()}
        if self.name.startswith("train.eval_"):
            small["train.eval_freq"] = 8
        small |= {f"agent.{key}": value for key, value in AGENTS[self.agent].items()}
        parent, _, leaf = self.name.rpartition(".")
        if leaf in LINE and parent.count(".") == 1:
            small |= {f"{parent}.{key}": value for key, value in LINE.items()}
        small.pop(parent, None)
        return small


def nested(dotted: Mapping[str, Any]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for key, value in dotted.items():
        *path, leaf = key.split(".")
        branch = tree
        for name in path:
            branch = branch.setdefault(name, {})
        branch[leaf] = value
    return tree


def agent_keys(agent: str) -> list[str]:
    """Every key of an agent, including those of its networks, optimiser and schedules."""
    constructor = import_object(find_agent(agent).algorithm)
    keys = [key for key in signature(constructor).parameters if is_known(agent, {key: None})]
    keys += [key + f".{part}" for key in keys if not is_known(agent, {key: {**LINE, "strat": 0}}) for part in LINE]
    policy = constructor.policy_aliases[find_agent(agent).policy]
    inner = [key for key in signature(policy).parameters if not key.endswith(("_space", "schedule"))]
    keys += [f"policy_kwargs.{key}" for key in inner]
    if "features_extractor_kwargs" in inner:
        kwargs = {"features_extractor_kwargs": InverseRange, "optimizer_kwargs": th.optim.Adam}
        keys += [
            f"policy_kwargs.{place}.{key}"
            for place, cls in kwargs.items()
            for key in signature(cls).parameters
            if key not in ("observation_space", "params", "lr", "capturable", "differentiable")
        ]
    return [f"agent.{key}" for key in ["name", *keys]]


def is_known(agent: str, arguments: dict[str, Any]) -> bool:
    try:
        check_arguments(find_agent(agent), arguments)
    except InputError as error:
        return "unknown key" not in str(error)
    return True


def all_keys() -> list[Key]:
    train = [f"train.{field.name}" for field in dataclasses.fields(TrainSettings)]
    keys = [Key(agent, "maze", key) for agent in AGENTS for key in [*agent_keys(agent), *train]]
    for task in TASKS:
        names = ["name", "observation", *(field.name for field in dataclasses.fields(find_task(task)))]
        agents = ("ppo",) if task in ("drive", "navigate") else ("qlearn", "dqn")  # which need named actions
        keys += [Key(agent, task, f"task.{name}") for agent in agents for name in names]
    return keys


KEYS = all_keys()


# ---- daily: a sample


@pytest.mark.parametrize(
    ("agent", "key", "value"),
    [
        ("qlearn", "agent.gamma", 10**400),
        ("qlearn", "agent.exploration", "epsilon\0"),
        ("qlearn", "task.world", "x" * 5000 + ".yaml"),
        ("qlearn", "task.range_bins", [1e308, INF]),
        ("dqn", "agent.buffer_size", 10**30),
        ("dqn", "agent.policy_kwargs.net_arch", [10**6, 10**6]),
        ("ppo", "agent.n_steps", -1),
        ("ppo", "agent.policy_kwargs.optimizer_class", "os:system"),
        ("ppo", "agent.learning_rate.end", NAN),
        ("ppo", "train.device", "cuda:99"),
        ("ppo", "train.eval_steps", "é🤖"),
    ],
)
def test_a_sample_of_values_is_refused_in_one_line(agent, key, value, refused, tmp_path):
    case = Key(agent, "maze", key).case(value, in_file=False)
    asked = {**case["settings"], "train.total_timesteps": 8}
    message = refused(lambda: train_config(resolve(agent, "maze", settings=asked), tmp_path / "run"))
    assert any(name in message.lower() for name in case["named"])


# ---- on demand: every key


class Attempts:
    """A process that runs `try_settings.py`; replaced if it hangs or dies."""

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None

    def __call__(self, case: dict[str, Any]) -> str:
        """The failure of a case; "" if there is none."""
        if self._process is None or self._count >= CASES:
            self.stop()
            self._start()
        self._count += 1
        try:
            self._process.stdin.write(pickle.dumps(case))
            self._process.stdin.flush()
            if not select.select([self._process.stdout], [], [], SECONDS)[0]:
                failure = f"hangs for more than {SECONDS:g} s"
            elif line := self._process.stdout.readline():
                return json.loads(line)
            else:
                failure = f"kills its process, exit code {self._process.wait(5)}"
        except BrokenPipeError:
            failure = f"kills its process, exit code {self._process.wait(5)}"
        self.stop()
        return failure

    def _start(self) -> None:
        self._count = 0
        program = [sys.executable, str(Path(__file__).with_name("try_settings.py"))]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen(program, **pipes)
        assert json.loads(self._process.stdout.readline()) == "ready"

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                with suppress(BrokenPipeError):
                    pipe.close()
            self._process = None


@pytest.fixture(scope="module")
def attempts() -> Iterator[Attempts]:
    """A function that returns the failure of a case."""
    process = Attempts()
    yield process
    process.stop()


fuzz = settings(
    derandomize=True,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],  # a case that hangs is not shrunk
    suppress_health_check=list(HealthCheck),
    print_blob=False,
)


def with_extremes(test: Any) -> Any:
    """The test with every extreme as an example, by settings and by file in turn."""
    for i, value in enumerate(EXTREMES):
        test = example(value=value, in_file=bool(i % 2))(test)
    return test


@pytest.mark.fuzz
@pytest.mark.parametrize("key", KEYS, ids=str)
@with_extremes
@settings(fuzz, max_examples=25)
@given(value=VALUES, in_file=st.booleans())
def test_any_value_of_any_key_trains_or_is_refused_in_one_line(attempts, key, value, in_file):
    if in_file and value in (10**5000, "\ud800"):
        return  # PyYAML writes neither
    shown = f"an integer of {value.bit_length()} bits" if isinstance(value, int) else repr(value)[:100]
    assert not (failure := attempts(key.case(value, in_file))), f"{key}={shown}: {failure}"


def written(text: str, place: str | None) -> dict[str, Any]:
    """A preset file with a text in it, or a --set, as `try_settings.py` takes them."""
    small = {f"train.{key}": value for key, value in TRAIN.items()}
    if place is None:
        return {"settings": small, "pairs": [f"agent.gamma={text}"], "named": [""]}
    content = place.format(text).encode(errors="surrogatepass")  # also what is not UTF-8
    return {"settings": small, "file": content, "named": [""]}


@pytest.mark.fuzz
@settings(fuzz, max_examples=60)
@given(text=st.text(max_size=30) | st.sampled_from(YAMLS), place=st.sampled_from([*PLACES, None]))
def test_any_text_as_yaml_trains_or_is_refused_in_one_line(attempts, text, place):
    assert not attempts(written(text, place))

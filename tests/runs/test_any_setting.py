"""Every key of a config with any value: it trains, or it is refused in one line that names the key or the file."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from inspect import signature
from itertools import pairwise
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
from tb2rl.tasks.registry import find_task

SHARES = 12  # of the extremes, one for each key; with `-m fuzz` each key has all
NAN, INF = float("nan"), float("inf")
LINE = {"start": 0.1, "end": 0.1, "fraction": 1.0}

AGENTS = {  # small enough that eight steps reach every part of an algorithm
    "qlearn": {},
    "dqn": {"learning_starts": 2, "batch_size": 4, "buffer_size": 64},
    "ppo": {"n_steps": 4, "batch_size": 4, "n_epochs": 1},
}
TRAIN = {"simulation": "kinematic", "n_envs": 2, "eval_freq": 0, "save_freq": 0, "eval_episodes": 1, "eval_steps": 4}

NUMBERS = (
    True, 0, 1, 3, -1, 2**31, 2**63, 10**9, 10**12, 10**30, 10**400, 10**5000,
    0.0, 0.5, -0.5, 2.5, 5e-324, 1e-30, 1e30, 1e38, 1e308, -1e308, NAN, INF, -INF,
)  # fmt: skip
TEXTS = (
    "", " ", "a", "1", "nan", "1e400", "auto", "epsilon", "None", "\n", "a\nb", "\0", "\ud800", "é🤖",
    "x" * 100_000, "..", ".", "/", "~", "no/such.yaml", "a.yaml", "\0.yaml", "x" * 5000 + ".yaml", "bullet",
    "cuda", "cuda:99", "cpu:7", "meta", "mps", "loop", "raw", "discrete", "qlearn", "ppo", ":", "a:b", "os:system",
    "torch.nn:ELU", "torch.nn:Linear", "torch.nn:Module", "torch.optim:SGD", "tb2rl.envs.features:InverseRange",
    "tb2rl.tasks:Task", "stable_baselines3:A2C", "stable_baselines3:SAC",
)  # fmt: skip
TREES = (
    None, [], [[]], [1], [0], [-1], [0.5, 0.5], [2, 1], [10**6, 10**6], [10**12], [1e308], [10**400], [NAN], ["a"],
    [None], [0, 0], [1, 2], [1] * 5000, [4, "step"], [1, "episode"], [10**12, "step"], {}, {"a": 1}, {1: 2},
    {None: None}, {"": {}}, [1e308, 1e308], [-1e308, -1e308, 1e308, 1e308], [0.0, 0.0, 0.0, 0.0], [{}], LINE,
    {**LINE, "start": 1e308}, {**LINE, "end": -1.0}, {"start": 1}, {"pi": [4], "vf": [4]}, {"pi": [], "vf": 3},
    date(2001, 1, 1), b"\xff",
)  # fmt: skip
EXTREMES = (*NUMBERS, *TEXTS, *TREES)
_LAUGHS = "".join(f"{b}: &{b} [{', '.join(9 * [f'*{a}'])}], " for a, b in pairwise("abcdefghi"))  # 9**9 zeros
YAMLS = (  # in the place of a value
    "1" * 5000, "0x", "0b", "0o9", "1:99", "1__", "1e400", "-.inf", "2001-99-99", "2001-01-01", "2001-01-01 99:99:99",
    "=", "<<", "!!int x", "!!float x", "!!timestamp x", "!!binary é", "!!python/name:os.system", "!!set {a}",
    "!!omap [a: 1]", "!x 1", "[" * 5000, "[" * 300 + "]" * 300, "{a: " * 300 + "}" * 300, "&a [*a]", "&a {a: *a}", "*a",
    "{? [1] : 2}", "{? {} : 2}", "{a: &a 0, " + _LAUGHS + "}", "{<<: 1}", "{<<: [1]}", "{a: 1, a: 2}", "\t", "@", "`",
    "%", "'", '"', '"\\ud800"', '"\\U99999999"', "\0", "\x7f", "\ufeff", "\ud800",
)  # fmt: skip
PLACES = ("{}", "agent: {{policy_kwargs: {}}}", "task: {{world: {}}}", "train: {{{}: 1}}")

_INTEGERS = st.integers(-3, 70) | st.integers(2**31, 2**70) | st.integers(-(2**70), -(2**31))
_SCALARS = st.none() | st.booleans() | _INTEGERS | st.floats() | st.text(max_size=20)
_TREES = st.recursive(
    _SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5) | _SCALARS, inner, max_size=3),
    max_leaves=6,
)
VALUES = st.sampled_from(EXTREMES) | _TREES


# ---- the keys


@dataclass(frozen=True)
class Key:
    """A key of a training that is small otherwise."""

    agent: str
    task: str
    name: str

    def __str__(self) -> str:
        return f"{self.agent}-{self.task}-{self.name}"

    def case(self, value: Any, in_file: bool) -> dict[str, Any]:
        """The training with a value for this key, as `attempts.py` takes it."""
        section, *path = self.name.split(".")
        named = [section, "cannot import"] if path == ["name"] else [*path, "mine.yaml"]
        who = {"agent": None if self.name == "agent.name" else self.agent}
        who |= {"task": None if self.name == "task.name" else self.task, "named": named}
        values = {**self._others(), self.name: value}
        if not in_file:
            return {**who, "settings": values}
        text = yaml.safe_dump(_nested(values), allow_unicode=True)
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


def _nested(dotted: Mapping[str, Any]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for key, value in dotted.items():
        *path, leaf = key.split(".")
        branch = tree
        for name in path:
            branch = branch.setdefault(name, {})
        branch[leaf] = value
    return tree


def agent_keys(agent: str) -> list[str]:
    """Every key of an agent, those of its networks, optimiser and schedules too."""
    constructor = import_object(find_agent(agent).algorithm)
    keys = [key for key in signature(constructor).parameters if _is_known(agent, {key: None})]
    keys += [key + f".{part}" for key in keys if _takes_schedule(agent, key) for part in LINE]
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


def _is_known(agent: str, arguments: dict[str, Any]) -> bool:
    try:
        check_arguments(find_agent(agent), arguments)
    except InputError as error:
        return "unknown key" not in str(error)
    return True


def _takes_schedule(agent: str, key: str) -> bool:
    return not _is_known(agent, {key: {**LINE, "strat": 0}})


def _all_keys() -> list[Key]:
    train = [f"train.{field.name}" for field in dataclasses.fields(TrainSettings)]
    keys = [Key(agent, "maze", key) for agent in AGENTS for key in [*agent_keys(agent), *train]]
    for task in TASKS:
        names = ["name", "observation", *(field.name for field in dataclasses.fields(find_task(task)))]
        agents = ("ppo",) if task in ("drive", "navigate") else ("qlearn", "dqn")  # which learn no continuous actions
        keys += [Key(agent, task, f"task.{name}") for agent in agents for name in names]
    return keys


KEYS = _all_keys()


# ---- any value


@pytest.fixture(scope="module")
def check(attempt_settings):
    """A function that tries a value for a key, by settings or by a file."""

    def try_it(key: Key, value: Any, in_file: bool) -> None:
        if in_file and value == 10**5000:
            return  # Python writes no such number; what it makes of one that is written: see the preset files below
        if in_file and value == "\ud800":
            return  # half a character, which libyaml refuses before there is a key
        shown = f"an integer of {value.bit_length()} bits" if isinstance(value, int) else repr(value)[:100]
        assert not (wrong := attempt_settings(key.case(value, in_file))), f"{key}={shown}: {wrong}"

    return try_it


fuzz = settings(
    derandomize=True,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],  # a case that hangs is not to be shrunk
    suppress_health_check=list(HealthCheck),
    print_blob=False,
)


def with_extremes(test: Any) -> Any:
    """The test with every extreme as an example, by settings and by file in turn."""
    for i, value in enumerate(EXTREMES):
        test = example(value=value, in_file=bool(i % 2))(test)
    return test


@settings(fuzz, max_examples=40)
@given(key=st.sampled_from(KEYS), value=VALUES, in_file=st.booleans())
def test_a_value_trains_or_is_refused_in_one_line(check, key, value, in_file):
    check(key, value, in_file)


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(KEYS)), ids=lambda index: str(KEYS[index]))
def test_an_extreme_trains_or_is_refused_in_one_line(check, index):
    for i in range(index % SHARES, len(EXTREMES), SHARES):  # another share for the next key
        check(KEYS[index], EXTREMES[i], in_file=bool(i // SHARES % 2))


@pytest.mark.fuzz
@pytest.mark.parametrize("key", KEYS, ids=str)
@with_extremes
@settings(fuzz, max_examples=25)
@given(value=VALUES, in_file=st.booleans())
def test_any_value_of_any_key_trains_or_is_refused_in_one_line(check, key, value, in_file):
    check(key, value, in_file)


# ---- any text


def written(text: str, place: str | None) -> dict[str, Any]:
    """A preset file with a text in it, or a --set, as `attempts.py` takes them."""
    small = {f"train.{key}": value for key, value in TRAIN.items()}
    if place is None:
        return {"settings": small, "pairs": [f"agent.gamma={text}"], "named": [""]}
    content = place.format(text).encode(errors="surrogatepass")  # also what is not UTF-8
    return {"settings": small, "file": content, "named": [""]}


@settings(fuzz, max_examples=60)
@given(text=st.text(max_size=30), place=st.sampled_from([*PLACES, None]))
def test_any_text_as_yaml_trains_or_is_refused_in_one_line(attempt_settings, text, place):
    assert not attempt_settings(written(text, place))


@pytest.mark.fuzz
@pytest.mark.parametrize("place", [*PLACES, None])
@pytest.mark.parametrize("text", YAMLS, ids=lambda text: ascii(text)[:30])
def test_yaml_that_is_odd_trains_or_is_refused_in_one_line(attempt_settings, text, place):
    assert not attempt_settings(written(text, place))


@pytest.mark.parametrize("name", TEXTS, ids=lambda text: ascii(text)[:30])
def test_an_odd_name_of_a_preset_is_refused_in_one_line(attempt_settings, name):
    assert not attempt_settings({"preset": name, "named": ["preset", "file"]})

"""Any value of any key of a config trains, or is refused in one line that names the key or the file."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from datetime import date
from inspect import signature
from typing import Any

import pytest

from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import TASKS, import_object
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


@dataclass(frozen=True)
class Key:
    """A key of a training that is small otherwise."""

    agent: str
    task: str
    name: str

    def __str__(self) -> str:
        return f"{self.agent}-{self.task}-{self.name}"

    def case(self, value: Any) -> dict[str, Any]:
        """The training with a value for this key, see `isolated.py`."""
        section, *path = self.name.split(".")
        named = [section, "cannot import"] if path == ["name"] else path
        who = {"agent": None if self.name == "agent.name" else self.agent}
        who |= {"task": None if self.name == "task.name" else self.task, "named": named}
        return {**who, "settings": {**self._others(), self.name: value}}

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


def agent_keys(agent: str) -> list[str]:
    """Every key of an agent, including those of its networks, optimiser and schedules."""
    constructor = import_object(find_agent(agent).algorithm)
    keys = [key for key in signature(constructor).parameters if is_known(agent, {key: None})]
    keys += [key + f".{part}" for key in keys if not is_known(agent, {key: {**LINE, "strat": 0}}) for part in LINE]
    policy = constructor.policy_aliases[find_agent(agent).policy]
    inner = [key for key in signature(policy).parameters if not key.endswith(("_space", "schedule"))]
    keys += [f"policy_kwargs.{key}" for key in inner]
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
        ("qlearn", "task.range_bins", [1e308, INF]),
        ("dqn", "agent.buffer_size", 10**30),
        ("ppo", "agent.n_steps", -1),
        ("ppo", "agent.learning_rate.end", NAN),
        ("ppo", "train.eval_steps", "é🤖"),
    ],
)
def test_a_sample_of_values_is_refused_in_one_line(agent, key, value, refused, tmp_path):
    case = Key(agent, "maze", key).case(value)
    asked = {**case["settings"], "train.total_timesteps": 8}
    message = refused(lambda: train_config(resolve(agent, "maze", settings=asked), tmp_path / "run"))
    assert any(name in message.lower() for name in case["named"])


# ---- on demand: every key


@pytest.mark.fuzz
@pytest.mark.parametrize("key", all_keys(), ids=str)
def test_any_value_of_any_key_trains_or_is_refused_in_one_line(isolated, key):
    outcomes = [(number, *isolated(**key.case(value))) for number, value in enumerate(EXTREMES)]
    assert [(number, why) for number, outcome, why in outcomes if outcome == "failed"] == []


@pytest.mark.fuzz
@pytest.mark.parametrize("place", [*PLACES, None])
def test_any_text_as_yaml_trains_or_is_refused_in_one_line(isolated, place):
    """In a preset file, or as a --set."""
    small = {f"train.{key}": value for key, value in TRAIN.items()}
    for text in YAMLS:
        given = {"pairs": [f"agent.gamma={text}"]}
        if place is not None:
            given = {"preset": place.format(text).encode(errors="surrogatepass")}  # also what is not UTF-8
        outcome, why = isolated(settings=small, named=[""], **given)
        assert outcome != "failed", f"{text[:80]!r}: {why}"

"""Every key of a config with any value: it trains, or it is refused in one line that names the key or the file."""

from __future__ import annotations

import dataclasses
import multiprocessing
import resource
import tempfile
import traceback
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from inspect import signature
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import torch as th
import yaml
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from tb2rl.agents._features import Nearness
from tb2rl.config import Config, TrainSettings, check_arguments, parse_settings, resolve
from tb2rl.errors import InputError
from tb2rl.registry import TASKS, find_agent, find_task, import_object
from tb2rl.training import train_config

SECONDS = 20.0  # that a few steps may take; the first case of a process has imports and compiling besides
MEMORY = 4 * 2**30  # [B] of addresses that the cases of a process may take
ATTEMPTS = 250  # cases of a process: what each leaves behind must not be what another one fails for
STEPS = 8
SHARES = 6  # of the extremes, one for each key; with `-m fuzz` each key has all
NAN, INF = float("nan"), float("inf")
LINE = {"start": 0.1, "end": 0.1, "fraction": 1.0}

AGENTS = {  # small enough that eight steps reach every part of an algorithm
    "qlearn": {},
    "dqn": {"learning_starts": 2, "batch_size": 4, "buffer_size": 64},
    "ppo": {"n_steps": 4, "batch_size": 4, "n_epochs": 1},
}
SMALL_TRAINING = {
    "simulation": "kinematic", "n_envs": 2, "total_timesteps": STEPS, "eval_freq": 0, "save_freq": 0,
    "eval_episodes": 1, "eval_steps": 4,
}  # fmt: skip

# What is allowed and only takes long is cut after it has been checked; allocations are not.
LONG_TRAINING = {"total_timesteps": STEPS, "eval_steps": STEPS}
LONG_ALGORITHM = {"n_epochs": 2, "gradient_steps": 2, "train_freq": STEPS}

NUMBERS = (
    True, 0, 1, 3, -1, 2**31, 2**63, 10**9, 10**12, 10**30, 10**400, 10**5000,
    0.0, 0.5, -0.5, 2.5, 5e-324, 1e-30, 1e30, 1e38, 1e308, -1e308, NAN, INF, -INF,
)  # fmt: skip
TEXTS = (
    "", " ", "a", "1", "nan", "1e400", "auto", "epsilon", "None", "\n", "a\nb", "\0", "\ud800", "é🤖",
    "x" * 100_000, "..",
    ".", "/", "~", "no/such.yaml", "a.yaml", "\0.yaml", "x" * 5000 + ".yaml", "bullet", "cuda", "cuda:99",
    "cpu:7", "meta", "mps", "loop", "raw", "discrete",
    "qlearn", "ppo", ":", "a:b", "os:system", "torch.nn:ELU", "torch.nn:Linear", "torch.nn:Module",
    "torch.optim:SGD",
    "tb2rl.agents._features:Nearness", "tb2rl.tasks:Task", "stable_baselines3:A2C", "stable_baselines3:SAC",
)  # fmt: skip
TREES = (
    None, [], [[]], [1], [0], [-1], [0.5, 0.5], [2, 1], [10**6, 10**6], [10**12], [1e308], [10**400], [NAN],
    ["a"], [None],
    [0, 0], [1, 2], [1] * 5000, [4, "step"], [1, "episode"], [10**12, "step"], {}, {"a": 1}, {1: 2},
    {None: None}, {"": {}},
    [1e308, 1e308], [-1e308, -1e308, 1e308, 1e308], [0.0, 0.0, 0.0, 0.0], [{}], LINE, {**LINE, "start": 1e308},
    {**LINE, "end": -1.0}, {"start": 1}, {"pi": [4], "vf": [4]}, {"pi": [], "vf": 3}, date(2001, 1, 1), b"\xff",
)  # fmt: skip
EXTREMES = (*NUMBERS, *TEXTS, *TREES)
_LAUGHS = "".join(f"{b}: &{b} [{', '.join(9 * [f'*{a}'])}], " for a, b in pairwise("abcdefghi"))  # 9**9 zeros
YAMLS = (  # in the place of a value
    "1" * 5000, "0x", "0b", "0o9", "1:99", "1__", "1e400", "-.inf", "2001-99-99", "2001-01-01",
    "2001-01-01 99:99:99", "=", "<<",
    "!!int x", "!!float x", "!!timestamp x", "!!binary é", "!!python/name:os.system", "!!set {a}",
    "!!omap [a: 1]", "!x 1",
    "[" * 5000, "[" * 300 + "]" * 300, "{a: " * 300 + "}" * 300, "&a [*a]", "&a {a: *a}", "*a", "{? [1] : 2}",
    "{? {} : 2}",
    "{a: &a 0, " + _LAUGHS + "}", "{<<: 1}", "{<<: [1]}", "{a: 1, a: 2}", "\t", "@", "`", "%", "'", '"',
    '"\\ud800"', '"\\U99999999"', "\0", "\x7f", "\ufeff", "\ud800",
)  # fmt: skip
PLACES = ("{}", "agent: {{policy_kwargs: {}}}", "task: {{maze: {}}}", "train: {{{}: 1}}")  # fmt: skip

_INTEGERS = st.integers(-3, 70) | st.integers(2**31, 2**70) | st.integers(-(2**70), -(2**31))
_SCALARS = st.none() | st.booleans() | _INTEGERS | st.floats() | st.text(max_size=20)
_TREES = st.recursive(
    _SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5) | _SCALARS, inner, max_size=3),
    max_leaves=6,
)
VALUES = st.sampled_from(EXTREMES) | _TREES


@dataclass(frozen=True)
class Case:
    """A value for one key of a training that is small otherwise."""

    agent: str
    task: str
    key: str
    value: Any = None
    in_file: bool = False

    def __str__(self) -> str:
        return f"{self.agent}-{self.task}-{self.key}"

    def settings(self) -> dict[str, Any]:
        small = {f"train.{key}": value for key, value in SMALL_TRAINING.items()}
        if self.key.startswith("train.eval_"):
            small["train.eval_freq"] = STEPS
        small |= {f"agent.{key}": value for key, value in AGENTS[self.agent].items()}
        parent, _, leaf = self.key.rpartition(".")
        if leaf in LINE and parent.count(".") == 1:
            small |= {f"{parent}.{key}": value for key, value in LINE.items()}
        if parent in small:
            del small[parent]
        return {**small, self.key: self.value}

    def config(self, folder: Path) -> Config:
        agent = None if self.key == "agent.name" else self.agent
        task = None if self.key == "task.name" else self.task
        if not self.in_file:
            return resolve(agent, task, settings=self.settings())
        text = yaml.safe_dump(_nested(self.settings()), allow_unicode=True)
        (folder / "mine.yaml").write_text(text, encoding="utf-8")
        return resolve(agent, task, preset=str(folder / "mine.yaml"))

    def named(self) -> list[str]:
        """What a message may call the key."""
        section, *path = self.key.split(".")
        return [section, "cannot import"] if path == ["name"] else [*path, "mine.yaml"]


@dataclass(frozen=True)
class Written:
    """A preset file or a --set, as it is written."""

    text: str
    in_file: bool

    def config(self, folder: Path) -> Config:
        small = {f"train.{key}": value for key, value in SMALL_TRAINING.items() if key != "total_timesteps"}
        if not self.in_file:
            return resolve(settings=small | parse_settings([f"agent.gamma={self.text}"]))
        (folder / "mine.yaml").write_bytes(self.text.encode(errors="surrogatepass"))  # also what is not UTF-8
        return resolve(preset=str(folder / "mine.yaml"), settings=small)

    def named(self) -> list[str]:
        return [""]


@dataclass(frozen=True)
class Preset:
    """The name of a preset."""

    name: str

    def config(self, folder: Path) -> Config:
        return resolve(preset=self.name)

    def named(self) -> list[str]:
        return ["preset", "file"]


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
    keys = [key for key in signature(constructor).parameters if _is_known(agent, key)]
    policy = constructor.policy_aliases[find_agent(agent).policy]
    inner = [key for key in signature(policy).parameters if not key.endswith(("_space", "schedule"))]
    keys += [key + f".{part}" for key in keys if _takes_schedule(agent, key) for part in LINE]
    keys += [f"policy_kwargs.{key}" for key in inner]
    if "features_extractor_kwargs" in inner:
        kwargs = {"features_extractor_kwargs": Nearness, "optimizer_kwargs": th.optim.Adam}
        keys += [
            f"policy_kwargs.{place}.{key}"
            for place, cls in kwargs.items()
            for key in signature(cls).parameters
            if key not in ("observation_space", "params", "lr", "capturable", "differentiable")
        ]
    return [f"agent.{key}" for key in ["name", *keys]]


def _is_known(agent: str, key: str) -> bool:
    try:
        check_arguments(find_agent(agent), {key: None})
    except InputError as error:
        return "unknown key" not in str(error)
    return True


def _takes_schedule(agent: str, key: str) -> bool:
    try:
        check_arguments(find_agent(agent), {key: {**LINE, "strat": 0}})
    except InputError as error:
        return f"unknown key of agent.{key} 'strat'" in str(error)
    return False


def _all_keys() -> list[Case]:
    train = [f"train.{field.name}" for field in dataclasses.fields(TrainSettings)]
    cases = [Case(agent, "maze", key) for agent in AGENTS for key in [*agent_keys(agent), *train]]
    for task in TASKS:
        names = ["name", "observation", *(field.name for field in dataclasses.fields(find_task(task)))]
        cases += [Case(agent, task, f"task.{name}") for agent in ("qlearn", "dqn") for name in names]
    return cases


KEYS = _all_keys()


def attempt(case: Case | Written | Preset) -> str:
    """What is wrong with how a case goes; "" if nothing is."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        warnings.filterwarnings("ignore", category=UserWarning, module="stable_baselines3")  # its advice on batches
        try:
            train_config(_short(case.config(Path(folder))), Path(folder, "run"))
        except InputError as error:
            message = str(error)
            if "\n" in message:
                return f"a message of several lines: {message!r}"
            return (
                "" if any(name in message.lower() for name in case.named()) else f"a message without the key: {message}"
            )
        except BaseException as error:
            return f"{type(error).__name__} at {_places(error)}: {error}"
        return "".join(
            f"{w.category.__name__} at {Path(w.filename).name}:{w.lineno}: {w.message}; " for w in warned[:1]
        )


def _places(error: BaseException) -> str:
    """Where an exception was raised, and the last lines of the project on the way there."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "/tb2rl/" in frame.filename or "/agents/" in frame.filename]
    places = [f"{Path(frame.filename).name}:{frame.lineno}" for frame in (frames[-1], *reversed(ours[-2:]))]
    return " < ".join(dict.fromkeys(places))


def _short(config: Config) -> Config:
    train = {key: min(getattr(config.train, key), most) for key, most in LONG_TRAINING.items()}
    agent = dict(config.agent_settings)
    for key, most in LONG_ALGORITHM.items():
        if isinstance(agent.get(key), int):
            agent[key] = min(agent[key], most)
        elif isinstance(agent.get(key), list | tuple) and agent[key] and isinstance(agent[key][0], int):
            agent[key] = (min(agent[key][0], most), *agent[key][1:])
    return dataclasses.replace(config, agent_settings=agent, train=dataclasses.replace(config.train, **train))


def _serve(connection: Any) -> None:
    """Attempt the cases that come, in a process that may run out of memory."""
    attempt(Case("ppo", "maze", "train.seed", 1))
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    connection.send("ready")
    while True:
        connection.send(attempt(connection.recv()))


class Worker:
    """A process that attempts cases; another one takes over if it hangs or dies."""

    def __init__(self) -> None:
        self._process: Any = None

    def attempt(self, case: Case | Written | Preset) -> str:
        if self._process is None or self._attempts >= ATTEMPTS:
            self.stop()
            self._start()
        self._attempts += 1
        self._connection.send(case)
        try:
            if self._connection.poll(SECONDS):
                return self._connection.recv()
            wrong = f"hangs for more than {SECONDS:g} s"
        except (EOFError, ConnectionError):
            self._process.join(5)
            wrong = f"kills its process, exit code {self._process.exitcode}"
        self.stop()
        return wrong

    def _start(self) -> None:
        self._attempts = 0
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,))
        self._process.start()
        theirs.close()
        assert self._connection.recv() == "ready"

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._connection.close()
            self._process = None


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    worker = Worker()
    yield worker
    worker.stop()


def check(worker: Worker, case: Case) -> None:
    if case.in_file and case.value == 10**5000:
        return  # Python writes no such number; what it makes of one that is written: see the preset files below
    assert not (wrong := worker.attempt(case)), f"{case}={_shown(case.value)}: {wrong}"


def _shown(value: Any) -> str:
    text = f"an integer of {value.bit_length()} bits" if isinstance(value, int) and abs(value) > 1e300 else repr(value)
    return text if len(text) < 100 else f"{text[:80]}... ({len(text)} characters)"


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
@given(case=st.sampled_from(KEYS), value=VALUES, in_file=st.booleans())
def test_a_value_trains_or_is_refused_in_one_line(worker, case, value, in_file):
    check(worker, dataclasses.replace(case, value=value, in_file=in_file))


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(KEYS)), ids=lambda index: str(KEYS[index]))
def test_an_extreme_trains_or_is_refused_in_one_line(worker, index):
    for i in range(index % SHARES, len(EXTREMES), SHARES):  # another share for the next key
        check(worker, dataclasses.replace(KEYS[index], value=EXTREMES[i], in_file=bool(i // SHARES % 2)))


@pytest.mark.fuzz
@pytest.mark.parametrize("case", KEYS, ids=str)
@with_extremes
@settings(fuzz, max_examples=25)
@given(value=VALUES, in_file=st.booleans())
def test_any_value_of_any_key_trains_or_is_refused_in_one_line(worker, case, value, in_file):
    check(worker, dataclasses.replace(case, value=value, in_file=in_file))


@settings(fuzz, max_examples=60)
@given(text=st.text(max_size=30), place=st.sampled_from(PLACES), in_file=st.booleans())
def test_any_text_as_yaml_trains_or_is_refused_in_one_line(worker, text, place, in_file):
    written = Written(place.format(text) if in_file else text, in_file)
    assert not (wrong := worker.attempt(written)), f"{_shown(written)}: {wrong}"


@pytest.mark.fuzz
@pytest.mark.parametrize("place", [*PLACES, None])
@pytest.mark.parametrize("text", YAMLS, ids=lambda text: ascii(text)[:30])
def test_yaml_that_is_odd_trains_or_is_refused_in_one_line(worker, text, place):
    written = Written(place.format(text) if place else text, place is not None)
    assert not (wrong := worker.attempt(written)), f"{_shown(written)}: {wrong}"


@pytest.mark.parametrize("name", TEXTS, ids=lambda text: ascii(text)[:30])
def test_an_odd_name_of_a_preset_is_refused_in_one_line(worker, name):
    assert not (wrong := worker.attempt(Preset(name))), f"{_shown(name)}: {wrong}"

"""Search spaces: the files of `configs/tuning`, and what is wrong with others."""

from functools import partial

import pytest
import yaml

from tb2rl.core.agent import find_agent
from tb2rl.core.files import top_folder
from tb2rl.core.plugins import agent_names
from tb2rl.runs.config import resolve
from tb2rl.tune import main
from tb2rl.tuning.study import parse_space, read_space

FILES = sorted(file.stem for file in (top_folder("configs") / "tuning").glob("*.yaml"))
TASKS = {"sac": "drive", "td3": "drive"}


def test_every_agent_that_learns_has_a_space():
    assert sorted(name for name in agent_names() if find_agent(name).algorithm is not None) == FILES


@pytest.mark.parametrize("name", FILES)
def test_every_value_of_a_built_in_space_fits_its_agent_and_no_key_comes_twice(name):
    if name == "recurrent_ppo":
        pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    config = partial(resolve, name, TASKS.get(name, "maze"), None)
    tree = read_space(name, {}, lambda settings: config({"train.simulation": "kinematic", **settings}))
    text = (top_folder("configs") / "tuning" / f"{name}.yaml").read_text()
    assert len(tree) == sum(line[:1].isalpha() for line in text.splitlines())


def test_lists_and_null_are_choices_and_come_back_as_they_were():
    tree = {"agent.policy_kwargs.net_arch": {"choices": [[64, 64], {"pi": [8]}, None, "a", 2]}}
    (entry,) = parse_space(tree, "file").values()
    assert [entry.decode(label) for label in entry.distribution.choices] == [[64, 64], {"pi": [8]}, None, "a", 2]


def test_whole_ends_make_whole_numbers():
    whole, real = parse_space({"a.b": {"low": 1, "high": 8, "log": True}, "a.c": {"low": 1.0, "high": 8}}, "f").values()
    assert (type(whole.distribution).__name__, whole.distribution.log) == ("IntDistribution", True)
    assert type(real.distribution).__name__ == "FloatDistribution"


def test_what_a_user_fixed_is_not_searched(workdir):
    keys = ("agent.gamma", "agent.learning_rate.start", "agent.learning_rate_end", "task.range_bins")
    (workdir / "space.yaml").write_text(yaml.safe_dump({key: {"low": 0, "high": 1} for key in keys}))
    fixed = {"agent.learning_rate": 0.1, "task.range_bins": [1.0]}
    assert [*read_space("space.yaml", fixed, lambda _: None)] == ["agent.gamma", "agent.learning_rate_end"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("agent.gama: {low: 0.9, high: 0.99}", "unknown key of agent 'gama'; did you mean 'gamma'?"),
        ("gamma: {low: 0.9, high: 0.99}", "needs its section, one of agent.gamma"),
        ("agent.gamma: {low: 0.9, hihg: 0.99}", "'hihg'; did you mean 'high'? known: high, log, low"),
        ("agent.gamma: {choices: [0.9, 0.95], log: true}", "unknown key of space.yaml: agent.gamma 'log'"),
        ("agent.gamma: {low: 0.99, high: 0.9}", "low must be less than high"),
        ("agent.gamma: {low: 0.0, high: 0.9, log: true}", "greater than 0 if log is true"),
        ("agent.gamma: {low: 0.9}", "high: Field required"),
        ("agent.gamma: {low: 0.9, high: 1.2}", "agent.gamma: Input should be less than or equal to 1, got 1.2"),
        ("agent.update: {choices: [textbook, tutorail]}", "Input should be 'textbook' or 'tutorial', got 'tutorail'"),
        ("agent.gamma: {choices: [0.9]}", "should have at least 2 items"),
        ("agent.gamma: {choices: [0.9, 0.9]}", "the choices must differ"),
        ("agent.gamma: 0.9", "expected a mapping of keys to values, got 0.9"),
        ("[agent.gamma]", "expected settings to search"),
        ("", "expected settings to search"),
    ],
)
def test_a_file_that_does_not_fit_is_named_in_one_line(text, words, workdir, refused):
    (workdir / "space.yaml").write_text(text)
    refused(main, "--agent qlearn --space space.yaml", ["space.yaml", words])

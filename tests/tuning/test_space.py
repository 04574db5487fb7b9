"""Search spaces: the files of `configs/tuning`, and what is wrong with others."""

from __future__ import annotations

from functools import partial

import pytest
import yaml

from tb2rl.core.agent import find_agent
from tb2rl.core.errors import InputError
from tb2rl.core.files import top_folder
from tb2rl.core.plugins import agent_names
from tb2rl.runs.layers import resolve
from tb2rl.tune import main
from tb2rl.tuning.space import check_space, find_space, space_from, without_fixed

FILES = sorted(file.stem for file in (top_folder("configs") / "tuning").glob("*.yaml"))
TASKS = {"sac": "drive", "td3": "drive"}


def test_every_agent_that_learns_has_a_space():
    assert sorted(name for name in agent_names() if find_agent(name).algorithm is not None) == FILES


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("simulation", ["kinematic", "bullet"])
def test_every_value_of_a_built_in_space_fits_its_agent(name, simulation):
    if name == "recurrent_ppo":
        pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    tree, file = find_space(name)
    base = {"train.simulation": simulation}
    config = partial(resolve, name, TASKS.get(name, "maze"), None)
    check_space(space_from(tree, file), file, lambda settings: config({**base, **settings}))


def test_lists_and_null_are_choices_and_come_back_as_they_were():
    tree = {"agent.policy_kwargs.net_arch": {"choices": [[64, 64], {"pi": [8]}, None, "a", 2]}}
    (entry,) = space_from(tree, "file").values()
    assert [entry.value(label) for label in entry.distribution.choices] == [[64, 64], {"pi": [8]}, None, "a", 2]


def test_whole_ends_make_whole_numbers():
    whole, real = space_from({"a.b": {"low": 1, "high": 8, "log": True}, "a.c": {"low": 1.0, "high": 8}}, "f").values()
    assert (type(whole.distribution).__name__, whole.distribution.log) == ("IntDistribution", True)
    assert type(real.distribution).__name__ == "FloatDistribution"


def test_what_a_user_fixed_is_not_searched():
    tree = {"agent.gamma": 0, "agent.learning_rate.start": 0, "agent.learning_rate_end": 0, "task.range_bins": 0}
    fixed = {"agent.learning_rate": 0.1, "task.range_bins": [1.0]}
    assert [*without_fixed(tree, fixed)] == ["agent.gamma", "agent.learning_rate_end"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("agent.gama: {low: 0.9, high: 0.99}", "unknown key of agent 'gama'; did you mean 'gamma'?"),
        ("agnt.gamma: {low: 0.9, high: 0.99}", "unknown section of the settings 'agnt'; did you mean 'agent'?"),
        ("gamma: {low: 0.9, high: 0.99}", "needs its section: agent.gamma"),
        ("agent.gamma: {low: 0.9, hihg: 0.99}", "'hihg'; did you mean 'high'? known: high, log, low"),
        ("agent.gamma: {choices: [0.9, 0.95], log: true}", "unknown key of space.yaml: agent.gamma 'log'"),
        ("agent.gamma: {low: 0.99, high: 0.9}", "low must be less than high"),
        ("agent.gamma: {low: 0.0, high: 0.9, log: true}", "greater than 0 where log is true"),
        ("agent.gamma: {low: 0.9}", "high: Field required"),
        ("agent.gamma: {low: 0.9, high: 1.2}", "agent.gamma: Input should be less than or equal to 1, got 1.2"),
        ("agent.update: {choices: [textbook, tutorail]}", "Input should be 'textbook' or 'tutorial', got 'tutorail'"),
        ("agent.gamma: {choices: [0.9]}", "should have at least 2 items"),
        ("agent.gamma: {choices: [0.9, 0.9]}", "the choices must differ"),
        ("agent.gamma: 0.9", "expected a mapping of keys to values, got 0.9"),
        ("[agent.gamma]", "expected settings with what to search"),
        ("", "expected settings with what to search"),
    ],
)
def test_a_file_that_does_not_fit_is_named_in_one_line_and_nothing_is_made(text, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "space.yaml").write_text(text)
    with pytest.raises(SystemExit) as stopped:
        main(["--agent", "qlearn", "--space", "space.yaml"])
    message = capsys.readouterr().err
    assert (stopped.value.code, message.count("\n")) == (2, 1)
    assert "space.yaml" in message
    assert words in message
    assert not (tmp_path / "runs").exists()


def test_a_name_that_is_not_known_suggests_the_nearest():
    with pytest.raises(InputError, match="unknown search space 'qlern'; did you mean 'qlearn'"):
        find_space("qlern")


def test_the_files_say_nothing_twice():
    for name in FILES:
        text = (top_folder("configs") / "tuning" / f"{name}.yaml").read_text()
        assert len(yaml.safe_load(text)) == sum(line[:1].isalpha() for line in text.splitlines())

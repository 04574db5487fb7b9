"""Policies that navigate, and agents that do not learn, are driven through suites; the zoo keeps what came of it."""

from __future__ import annotations

import json
import tomllib
from functools import partial
from importlib import import_module
from itertools import islice
from pathlib import Path

import pytest

from tb2rl.commands import seeds as training
from tb2rl.commands import suite as command
from tb2rl.core.agent import find_agent
from tb2rl.evaluation import evaluator
from tb2rl.evaluation.suite_result import kept_result, kept_summary
from tb2rl.execution.local import LocalExecutor
from tb2rl.runs import loading
from tb2rl.runs.folder import Run
from tb2rl.worlds.suites import SUITES
from tb2rl.zoo import entry, maintenance
from tb2rl.zoo.cards import overview
from tb2rl.zoo.entry import entries, other_suite_policies
from tb2rl.zoo.suite_policies import stale_results

keeper = import_module("tb2rl.zoo.__main__")

MINE = (
    "--agent qlearn --task navigate --simulation kinematic --total-timesteps 50"
    " --set task.world=loop task.named_actions=true task.observe=[goal] train.n_envs=1 train.eval_freq=50"
    " train.eval_episodes=1 train.eval_steps=5"
)
DWA = "--agent dwa --task navigate --set task.world=loop"
CHECKOUT = Path(__file__).parents[2]


@pytest.fixture
def own_zoo(tmp_path, monkeypatch, small_suite):
    """A zoo of its own, with one agent for suites of three worlds, and standard evaluations that are over soon."""
    zoo = tmp_path / "zoo"
    zoo.mkdir()
    (zoo / "recipes.yaml").write_text("")
    (zoo / "suites.yaml").write_text(f"dwa-goal: {DWA}\n")
    for module in (entry, loading):
        monkeypatch.setattr(module, "top_folder", lambda name: zoo)
    monkeypatch.setattr(training, "evaluate", partial(training.evaluate, episodes=2, steps=5, workers=1))
    monkeypatch.setattr(LocalExecutor, "as_completed", in_this_process)
    monkeypatch.setattr(evaluator, "processors", lambda: 1)
    set_suite(monkeypatch, small_suite)
    monkeypatch.chdir(tmp_path)
    return zoo


def in_this_process(_, function, jobs, shared=()):
    """`Executor.as_completed` without other processes."""
    return [(job, function(*shared, *job.arguments, job.folder)) for job in jobs]


def set_suite(monkeypatch, make, **changes) -> None:
    """Let this be what any suite is."""
    for module in (command, maintenance):
        monkeypatch.setattr(module, "find_suite", lambda name, path=None: make(name, **changes))


def section(zoo: Path) -> list[str]:
    """The lines of the table of suites."""
    _, _, text = (zoo / "README.md").read_text().partition("## Suites\n")
    return [line for line in text.splitlines() if line.startswith("|")]


def only_contestant():
    (suite_policy,) = other_suite_policies()
    return suite_policy


# ---- agents that do not learn


def test_an_agent_is_driven_once_and_has_a_row(own_zoo, driven, capsys):
    keeper.main(["build"])
    assert driven == [0, 1, 2]
    summary = kept_summary(own_zoo / "suites" / "dwa-goal-unseen.json")
    figures = summary.figures["all"]
    head, _, row = section(own_zoo)
    assert head.startswith("| driver | guide | success | 95 % interval | a | b | longest tenth | SPL | time | m/s |")
    low, high = (f"{100 * bound:.1f}" for bound in figures.success_interval)
    begins = f"| dwa-goal | goal | {100 * figures.success_rate:.1f} % | {low} to {high} % | "
    assert row.startswith(begins)
    assert f"{figures.spl:.3f} | - | {figures.mean_speed:.2f} | - |" in row
    assert "### unseen: 3 worlds" in (own_zoo / "README.md").read_text()
    result = Path("runs/suites/dwa-goal-unseen.json")
    assert kept_result(result).summary == summary, "with its worlds it stays among the runs"

    keeper.main(["build"])
    assert driven == [0, 1, 2], "what is there is kept"
    keeper.main(["build", "dwa-goal", "--again"])
    assert driven == [0, 1, 2] * 2


def test_other_worlds_or_another_task_are_driven_anew(own_zoo, driven, small_suite, monkeypatch):
    keeper.main(["build"])
    before = only_contestant().summary("unseen")
    set_suite(monkeypatch, small_suite, last=1.1)
    keeper.main(["build"])
    assert len(driven) == 6
    assert only_contestant().summary("unseen").suite_digest != before.suite_digest
    (own_zoo / "suites.yaml").write_text(f"dwa-goal: {DWA} task.guide=plan\n")
    assert only_contestant().summary("unseen") is None, "what was driven with another guide says nothing"
    keeper.main(["build"])
    assert len(driven) == 9
    assert section(own_zoo)[2].startswith("| dwa-goal | plan (map known) | ")


def test_an_interrupted_suite_goes_on_where_it_was(own_zoo, driven, monkeypatch, capsys):
    drives_of = command.drives_of

    def interrupted(*arguments):
        yield from islice(drives_of(*arguments), 2)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(command, "drives_of", interrupted)
        with pytest.raises(SystemExit, match="130"):
            keeper.main(["build"])
    assert not (own_zoo / "suites").exists()
    keeper.main(["build"])
    assert driven == [0, 1, 2]
    assert "continuing: 2 of 3 worlds" in capsys.readouterr().out


def test_barn_has_a_table_of_its_own_with_a_score_whose_formula_is_named(own_zoo, small_suite, monkeypatch):
    keeper.main(["build"])
    assert "barn" not in (own_zoo / "README.md").read_text()

    def barn(name: str, path: Path | None = None):
        if path is None:
            return small_suite(name)
        suite = small_suite(name, last=1.2)
        vars(suite).update(families=("barn",) * 3, references=(2.0, 2.0, 2.0), path=path)
        return suite

    for module in (command, maintenance):
        monkeypatch.setattr(module, "find_suite", barn)
    keeper.main(["build", "--barn", "my/worlds.npz"])
    text = (own_zoo / "suites" / "dwa-goal-barn.json").read_text()
    assert "my/worlds.npz" not in text, "nobody else has them there"
    score = json.loads(text)["figures"]["all"]["barn_score"]
    head, _, row = section(own_zoo)[3:]
    assert "longest tenth | SPL | time | m/s | closest [m] | score |" in head
    assert "| barn |" not in head
    assert row.endswith(f" {score:.3f} |")
    assert "The score is by the formula of BARN 2024: 2 OT to 8 OT." in (own_zoo / "README.md").read_text()

    keeper.main(["build"])
    assert len(section(own_zoo)) == 6, "without the worlds, what is there stays"


def test_worlds_of_barn_that_cannot_be_read_are_refused_before_anything_is_done(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(maintenance, "build", lambda *arguments: pytest.fail("trained"))
    with pytest.raises(SystemExit, match="2"):
        keeper.main(["build", "--barn", "missing.npz"])
    assert "missing.npz" in capsys.readouterr().err


# ---- policies that navigate


def test_a_policy_that_navigates_is_an_entry_with_its_suites(own_zoo, driven):
    (own_zoo / "recipes.yaml").write_text(f"mine: {MINE}\n")
    keeper.main(["build"])
    (mine,) = entries()
    assert driven == [0, 1, 2] * 2
    assert mine.is_built
    assert not (mine.folder / "elsewhere.json").exists()
    rows = section(own_zoo)[2:]
    assert [row.split(" | ")[:2] for row in rows] == [["| [mine](mine/README.md)", "goal"], ["| dwa-goal", "goal"]]
    text = (own_zoo / "README.md").read_text()
    assert "| [mine](mine/README.md), guide goal | " in text
    assert "| mine | " not in text, "it is not driven in the worlds of the others"
    assert "`navigate, loop, guide goal`" in overview([mine])

    text = (mine.folder / "README.md").read_text()
    assert "in `loop`, guide goal, " in text
    assert "| unseen | a | 2 | 0.0 % | " in text
    assert "- In suite `unseen`, `b`: 100.0 % of 1 worlds (time limit 1)." in text
    assert "**Falls short:** 0 % of its episodes are good, the zoo promises 95 %." in text
    assert mine.suite_policy.summary("unseen").policy == "zoo:mine"
    assert str(own_zoo) not in mine.suite_policy.file("unseen").read_text(), "nobody else has it there"
    keeper.main(["build"])
    assert len(driven) == 6


def test_a_summary_of_another_policy_does_not_count(own_zoo, driven, capsys):
    (own_zoo / "recipes.yaml").write_text(f"mine: {MINE}\n")
    keeper.main(["build", "mine"])
    (mine,) = entries()
    evaluation = (mine.folder / "evaluation.json").read_text()
    Run.open(mine.folder).save(loading.load(mine.folder), "best/policy", more=1)  # that of before goes with it
    (mine.folder / "evaluation.json").write_text(evaluation)
    (mine,) = entries()
    assert not mine.is_built
    with pytest.raises(SystemExit, match="1"):
        keeper.main(["check", "mine", "--episodes", "1"])
    assert "suites/mine-unseen.json is stale: its policy or task has changed or is gone" in capsys.readouterr().out
    keeper.main(["build", "mine"])
    assert driven == [0, 1, 2] * 2
    assert entries()[0].is_built


@pytest.mark.parametrize(
    ("settings", "promised"),
    [
        ("--agent ppo --set task.guide=plan", 0.99),
        ("--agent ppo --set task.guide=goal", 0.96),
        ("--preset navigate-people --set task.lookahead=1.0", 0.9),
        ("--agent qlearn --set task.named_actions=true task.guide=plan", 0.95),
        ("--agent qlearn --set task.named_actions=true task.guide=goal", 0.95),
    ],
)
def test_what_the_zoo_promises_of_one_that_navigates(settings, promised):
    asked = entry.Entry("mine", f"--task navigate {settings} task.world=loop", Path("nowhere"))
    vars(asked)["config"] = asked.requested
    assert (asked.navigates, asked.good, asked.promised, asked.promised_speed) == (True, "success", promised, 0.0)
    assert asked.not_driven == []


# ---- the check


def test_a_check_finds_summaries_that_are_touched_or_of_something_else(own_zoo, capsys):
    keeper.main(["build"])
    keeper.main(["check"])
    assert capsys.readouterr().out.endswith("0 cards hold, and 1 results of suites\n")
    file = own_zoo / "suites" / "dwa-goal-unseen.json"
    tree = json.loads(file.read_text())
    tree["figures"]["all"]["success_rate"] = 1.0
    file.write_text(json.dumps(tree))
    (own_zoo / "suites" / "gone-unseen.json").write_text(file.read_text())
    with pytest.raises(SystemExit, match="1"):
        keeper.main(["check"])
    said = capsys.readouterr().out
    assert "the table in README.md is not what the files say" in said
    assert "suites/gone-unseen.json is stale: its policy or task has changed or is gone" in said
    file.write_text("<<<<<<< HEAD")
    with pytest.raises(SystemExit, match="2"):
        keeper.main(["check"])
    assert "dwa-goal-unseen.json is not the summary of a suite" in capsys.readouterr().err


# ---- the zoo itself


@pytest.mark.parametrize("suite_policy", other_suite_policies(), ids=lambda suite_policy: suite_policy.name)
def test_other_suite_policies_have_the_name_of_their_agent_or_entry_and_variation(suite_policy):
    policy, agent, task = suite_policy.options.policy, suite_policy.options.agent, suite_policy.config.task
    who = policy.removeprefix("zoo:") if policy else f"{agent}-{task.guide}"
    usual = "none" if agent else loading.config_of(loading.load(policy)).task.variation
    how = "exact" if task.variation == "none" else task.variation
    assert suite_policy.name == (who if task.variation == usual else f"{who}-{how}")
    assert (suite_policy.digest is None) == (policy is None)
    assert policy or find_agent(agent).algorithm is None


def test_the_summaries_are_of_what_is_there_now():
    built = [each for each in entries() if (each.folder / "config.yaml").is_file()]
    assert (
        stale_results(entry.suites_folder().glob("*"), [*entry.suite_policies_of(built), *other_suite_policies()]) == []
    )


def test_whatever_a_policy_is_called_it_is_installed_and_summaries_are():
    tree = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))
    patterns = tree["tool"]["setuptools"]["package-data"]["tb2rl.zoo"]
    files = [
        "suites.yaml",
        *(f"suites/{each.name}-{suite}.json" for each in other_suite_policies() for suite in SUITES),
    ]
    files += [f"{each.name}/{name}" for each in entries() for name in ("README.md", "best/policy.safetensors")]
    assert [file for file in files if not any(matches(file, pattern) for pattern in patterns)] == []


def matches(file: str, pattern: str) -> bool:
    """Whether a file is one of a pattern, in which no * stands for a slash."""
    return file.count("/") == pattern.count("/") and Path(file).match(pattern)

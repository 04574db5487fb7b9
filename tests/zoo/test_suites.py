"""Policies that navigate, and agents that do not learn, are driven through suites; the zoo keeps what came of it."""

import json
from functools import partial
from pathlib import Path

import pytest

from tb2rl.commands import evaluate as command
from tb2rl.commands import train as training
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.evaluation.suites import SuiteResult
from tb2rl.execution.local import LocalExecutor
from tb2rl.runs import loading
from tb2rl.runs.folder import Run
from tb2rl.zoo import maintenance
from tb2rl.zoo.cards import overview
from tb2rl.zoo.entry import Entry, entries, policies_of_suites_yaml

MINE = (
    "--agent qlearn --task navigate --simulation kinematic --total-timesteps 50"
    " --set task.world=loop task.named_actions=true task.observe=[goal] train.n_envs=1 train.eval_freq=50"
    " train.eval_episodes=1 train.eval_steps=5"
)
BUILD = ["build", "--episodes", "2"]
DWA = "--agent dwa --task navigate --set task.world=loop"


@pytest.fixture
def suite_zoo(referees, own_zoo, monkeypatch, set_suite):
    """A zoo with one agent for suites of three worlds, one physics simulator, and evaluations that are over soon."""
    referees("Second", available=False)
    (own_zoo / "suites.yaml").write_text(f"dwa-goal: {DWA}\n")
    monkeypatch.setattr(training, "evaluate", partial(training.evaluate, episodes=2, steps=5, workers=1))
    monkeypatch.setattr(maintenance, "evaluate", lambda *a, **others: evaluate(*a, **others, steps=5))
    monkeypatch.setattr(LocalExecutor, "as_completed", in_this_process)
    monkeypatch.setattr("tb2rl.evaluation.evaluate.processors", lambda: 1)
    set_suite()
    return own_zoo


def in_this_process(_, function, jobs, shared=()):
    """`Executor.as_completed` without other processes."""
    return [(job, function(*shared, *job.arguments, *filter(None, [job.folder]))) for job in jobs]


@pytest.fixture
def set_suite(monkeypatch, small_suite):
    """A function that lets this be what any suite is, and with a path that of BARN."""

    def find_suite(name: str, path: Path | None = None, last: float = 1.0):
        suite = small_suite(name, last=last)
        if path is not None:
            vars(suite).update(families=("barn",) * 3, reference_lengths=(2.0, 2.0, 2.0), path=path)
        return suite

    def set_suite(**changes) -> None:
        for module in (command, maintenance):
            monkeypatch.setattr(module, "find_suite", partial(find_suite, **changes))

    return set_suite


def section(zoo: Path) -> list[str]:
    """The lines of the table of suites."""
    _, _, text = (zoo / "README.md").read_text(encoding="utf-8").partition("## Suites\n")
    return [line for line in text.splitlines() if line.startswith("|")]


def test_an_agent_is_driven_once_and_has_a_row_until_its_summary_is_touched(main, suite_zoo, driven, capsys):
    main(BUILD)
    assert driven == [0, 1, 2]
    file = suite_zoo / "suites" / "dwa-goal-unseen-first.json"
    summary = SuiteResult.read(file)
    figures = summary.figures["all"]
    head, _, row = section(suite_zoo)
    assert head.startswith("| policy | physics | guide | success | 95 % interval | sim-to-sim | a | b |")
    assert " | longest tenth | SPL | time ratio | speed [m/s] |" in head
    low, high = (f"{100 * bound:.1f}" for bound in figures.success_interval)
    assert row.startswith(f"| dwa-goal | First | goal | {100 * figures.success_rate:.1f} % | {low} to {high} % |  | ")
    assert f"{figures.spl:.3f} | - | {figures.mean_speed:.2f} | - |" in row
    assert "### unseen: 3 worlds" in (suite_zoo / "README.md").read_text(encoding="utf-8")
    result = Path("runs/suites/dwa-goal-unseen-first.json")
    assert SuiteResult.read(result).summary == summary, "with its worlds it stays among the runs"
    main(BUILD)
    assert driven == [0, 1, 2], "what is there is kept"

    main(["check"])
    assert capsys.readouterr().out.endswith("0 cards pass, and so do 1 results of suites\n")
    tree = json.loads(file.read_text(encoding="utf-8"))
    tree["figures"]["all"]["success_rate"] = 1.0
    file.write_text(json.dumps(tree))
    (suite_zoo / "suites" / "gone-unseen-first.json").write_text(file.read_text(encoding="utf-8"))
    with pytest.raises(SystemExit, match="1"):
        main(["check"])
    said = capsys.readouterr().out
    assert "README.md does not match the results" in said
    assert "suites/gone-unseen-first.json is stale: its policy or task has changed or is gone" in said
    file.write_text("<<<<<<< HEAD")
    with pytest.raises(SystemExit, match="2"):
        main(["check"])
    assert "dwa-goal-unseen-first.json is not the result of a suite" in capsys.readouterr().err


def test_other_worlds_and_another_task_and_again_are_driven_anew(main, suite_zoo, driven, set_suite):
    def summary():
        (policy,) = policies_of_suites_yaml()
        return policy.summary("unseen", "first")

    main(BUILD)
    before = summary()
    set_suite(last=1.1)
    main(BUILD)
    assert len(driven) == 6
    assert summary().suite_digest != before.suite_digest
    (suite_zoo / "suites.yaml").write_text(f"dwa-goal: {DWA} task.guide=plan\n")
    assert summary() is None, "what was driven with another guide says nothing"
    main(BUILD)
    assert len(driven) == 9
    assert section(suite_zoo)[2].startswith("| dwa-goal | First | plan (map known) | ")
    main([*BUILD, "dwa-goal", "--again"])
    assert len(driven) == 12


def test_barn_has_a_table_of_its_own_with_a_score_whose_formula_is_named(main, suite_zoo):
    main([*BUILD, "--barn", "my/worlds.npz"])
    text = (suite_zoo / "suites" / "dwa-goal-barn-first.json").read_text(encoding="utf-8")
    assert "my/worlds.npz" not in text, "nobody else has them there"
    score = json.loads(text)["figures"]["all"]["barn_score"]
    head, _, row = section(suite_zoo)[3:]
    assert "longest tenth | SPL | time ratio | speed [m/s] | clearance [m] | score |" in head
    assert "| barn |" not in head
    assert row.endswith(f" {score:.3f} |")
    assert "The score is from 0 to 0.5, by the formula of BARN 2024: 2 OT to 8 OT." in (
        suite_zoo / "README.md"
    ).read_text(encoding="utf-8")
    main(BUILD)
    assert len(section(suite_zoo)) == 6, "without the worlds, what is there stays"


def test_a_policy_that_navigates_is_an_entry_whose_summary_is_of_its_checkpoint(main, suite_zoo, driven, capsys):
    (suite_zoo / "recipes.yaml").write_text(f"mine: {MINE}\n")
    main(BUILD)
    (mine,) = entries()
    assert driven == [0, 1, 2] * 2
    assert mine.is_built
    assert not (mine.folder / "unseen_worlds.json").exists()
    rows = section(suite_zoo)[2:]
    assert [row.split(" | ")[:3] for row in rows] == [
        ["| [mine](mine/README.md)", "First", "goal"],
        ["| dwa-goal", "First", "goal"],
    ]
    text = (suite_zoo / "README.md").read_text(encoding="utf-8")
    assert "| [mine](mine/README.md), guide goal | " in text
    assert "| mine | " not in text, "it is not driven in the worlds of the others"
    assert "`navigate, loop, guide goal`" in overview([mine])

    text = (mine.folder / "README.md").read_text(encoding="utf-8")
    assert "world `loop`, guide goal, " in text
    assert "| unseen | First | a | 2 | 0.0 % | " in text
    assert "- In suite `unseen` in First, family `b`: 100.0 % of 1 worlds (endings: time limit 1)." in text
    assert "**Falls short:** 0 % of the episodes are successful, but the zoo promises 95 %." in text
    assert mine.suite_policy.summary("unseen", "first").policy == "zoo:mine"
    assert str(suite_zoo) not in mine.suite_policy.file("unseen", "first").read_text(encoding="utf-8"), (
        "nobody else has it there"
    )

    evaluation = (mine.folder / "evaluation.json").read_text(encoding="utf-8")
    Run.open(mine.folder).save(loading.load(mine.folder), "best/policy", more=1)  # that of before goes with it
    (mine.folder / "evaluation.json").write_text(evaluation)
    assert not entries()[0].is_built
    with pytest.raises(SystemExit, match="1"):
        main(["check", "mine", "--episodes", "1"])
    assert (
        "suites/mine-unseen-first.json is stale: its policy or task has changed or is gone" in capsys.readouterr().out
    )
    main(BUILD)
    assert len(driven) == 9
    assert entries()[0].is_built


def test_a_second_physics_is_added_to_what_is_there_with_columns_and_checks(
    main, suite_zoo, referees, driven, monkeypatch, capsys
):
    (suite_zoo / "recipes.yaml").write_text(f"mine: {MINE}\n")
    in_simulators, evaluated = [], maintenance.evaluate

    def recorded(*arguments, simulation, **others):
        in_simulators.append(simulation)
        return evaluated(*arguments, simulation=simulation, **others)

    monkeypatch.setattr(maintenance, "evaluate", recorded)
    main(BUILD)
    (mine,) = entries()
    assert mine.sim_to_sim.records.keys() == {"first"}
    assert in_simulators == [], "the standard evaluation has enough episodes"
    assert "| sim-to-sim | training steps |" not in (suite_zoo / "README.md").read_text(encoding="utf-8")

    referees("Second", available=True)
    driven.clear()
    main(BUILD)
    assert (in_simulators, driven) == (["second"], [0, 1, 2] * 2), "what is there is kept"
    (mine,) = entries()
    assert mine.sim_to_sim.records.keys() == {"first", "second"}
    text = (suite_zoo / "README.md").read_text(encoding="utf-8")
    assert "| in Second | sim-to-sim | training steps |" in text
    assert "| 0.0 % | 0.0 (-65.8 to 65.8) | 50 |" in text
    rows = [row.split(" | ") for row in section(suite_zoo)[2:]]
    assert [row[1] for row in rows] == ["First", "Second"] * 2
    assert [row[5] for row in rows] == ["", "0.0 (-56.1 to 56.1)"] * 2
    card = (mine.folder / "README.md").read_text(encoding="utf-8")
    assert "| metric | First | Second |" in card
    assert "- sim-to-sim difference (goal reached) Second - First: 0.0 points" in card
    assert "| unseen | Second | a | 2 | 0.0 % | " in card
    referees("First", available=False)
    (dwa,) = policies_of_suites_yaml()
    assert len(dwa.summaries_of("unseen")) == 2, "the defaults of a training here do not matter"
    referees("First", available=True)
    main(["build", "--episodes", "3"])
    assert in_simulators == ["second", "first", "second"], "they have too few episodes"
    capsys.readouterr()

    main(["check", "--episodes", "1"])
    shown = capsys.readouterr().out
    assert [f"mine: 0 % good episodes, 0.000 m/s in {title}" in shown for title in ("First", "Second")]
    assert shown.endswith("1 cards pass, and so do 4 results of suites\n")
    referees("Second", available=False)
    main(["check", "mine", "--episodes", "1"])
    shown = capsys.readouterr().out
    assert "without Second is not installed" in shown
    assert "m/s in Second" not in shown
    main(["check", "mine", "--episodes", "1", "--simulation", "kinematic"])
    assert "m/s in the kinematic simulator" in capsys.readouterr().out

    referees("Second", available=True)
    tree = json.loads((mine.folder / "evaluation.json").read_text(encoding="utf-8"))
    tree["by_simulation"]["first"]["success_rate"] = 1.0
    tree["by_simulation"]["second"].update(bad_episodes=[], mean_speed=0.25)
    (mine.folder / "evaluation.json").write_text(json.dumps(tree))
    assert "| 0 %, 0.25 m/s |" in overview(entries()), "the worse of both"
    with pytest.raises(SystemExit, match="1"):
        main(["check", "mine", "--episodes", "1"])
    shown = capsys.readouterr().out
    assert "mine: 0 % good episodes in Second, but its earlier evaluation implies at least 20.7 %" in shown
    assert "good episodes in First, but" not in shown
    assert "mine: its card differs from its files" in shown


@pytest.mark.parametrize(
    ("settings", "promised"),
    [
        ("--agent ppo --set task.guide=plan", 0.99),
        ("--agent ppo --set task.guide=goal", 0.96),
        ("--preset navigate-people --set task.lookahead=1.0", 0.9),
        ("--agent qlearn --set task.named_actions=true task.guide=goal", 0.95),
    ],
)
def test_what_the_zoo_promises_of_one_that_navigates(settings, promised):
    asked = Entry("mine", f"--task navigate {settings} task.world=loop", Path("nowhere"))
    vars(asked)["config"] = asked.recipe_config
    assert (asked.criterion, asked.promised_rate, asked.promised_speed) == ("success", promised, 0.0)
    assert asked.navigates
    assert asked.missing_worlds == []

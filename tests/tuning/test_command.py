"""The command `tune`, from its arguments to the preset and the page."""

import re
import signal
import sys
import time
from collections import Counter
from functools import partial
from pathlib import Path

import pytest
import yaml

from tb2rl.commands import tune as tune_command
from tb2rl.core.errors import install_extra
from tb2rl.evaluation.evaluate import Evaluator, evaluate
from tb2rl.train import main as train
from tb2rl.tune import main
from tb2rl.tuning import selection

FOLDER = Path("runs/tune/maze-qlearn")


@pytest.fixture
def here(workdir, monkeypatch, executor):
    """An empty folder; trials run in this process, and evaluations in PyBullet are short."""
    monkeypatch.setattr(tune_command, "make_executor", lambda _: executor)
    monkeypatch.setattr(selection, "_EPISODES", 2)
    monkeypatch.setattr(selection, "Evaluator", partial(Evaluator, workers=1))
    monkeypatch.setattr(selection, "evaluate", partial(evaluate, episodes=2, steps=20, workers=1))
    return workdir


@pytest.mark.slow
def test_a_search_ends_with_a_preset_and_a_page_and_again_with_the_same(here, tiny, capsys):
    command = ["--agent", "qlearn", "--trials", "3", "--seeds", "1", "--fresh", "1", "--set", *tiny]
    main(command)
    said = capsys.readouterr().out
    best = int(re.search(r"best: trial (\d+): python -m tb2rl.train --preset (.*)", said)[1])
    preset = (FOLDER / "best.yaml").read_text()
    page = (FOLDER / "report.html").read_text()
    for words in ("agent.exploration_final_eps", f"Trial {best} is the best", "<svg", "default", "2100000", "PyBullet"):
        assert words in page
    assert sorted(run.parent.name for run in FOLDER.glob("fresh/*/*")) == ["default", f"trial-{best}"]
    main(command)
    again = capsys.readouterr().out
    assert "of which 3 are done" in again
    assert not re.search(r"^trial \d+: .* good episodes after", again, flags=re.MULTILINE)
    assert (FOLDER / "best.yaml").read_text() == preset
    quick = "--total-timesteps 64 --eval-freq 0 --no-evaluation --no-progress --name it"
    train(["--preset", str(FOLDER / "best.yaml"), *quick.split()])
    written, trained = yaml.safe_load(preset), yaml.safe_load(Path("runs/maze/qlearn/it/config.yaml").read_text())
    assert trained["agent"] == {**trained["agent"], **written["agent"]}


def test_what_set_fixes_is_not_searched_and_a_study_without_a_complete_trial_says_so(
    here, tiny, monkeypatch, capsys, read_study
):
    monkeypatch.setattr(tune_command, "run_trials", lambda *_: False)
    with pytest.raises(SystemExit):
        main(["--minutes", "1", "--set", *tiny, "agent.gamma=0.9", "agent.learning_rate=0.2"])
    captured = capsys.readouterr()
    assert "time limit of 1 minutes reached" in captured.out
    assert captured.err == f"error: no trial of {FOLDER} is complete; raise --trials or --minutes\n"
    folder, _ = read_study(FOLDER)
    assert {*folder.space} == {"agent.averaging", "agent.exploration_fraction", "agent.exploration_final_eps"}
    assert folder.default.agent_arguments["gamma"] == 0.9


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--agent qlern", "unknown agent 'qlern'; did you mean 'qlearn'?"),
        ("--sampler tpee", "tune.sampler: Input should be 'tpe' or 'random', got 'tpee'"),
        ("--trials 0", "--trials: must be from 1 to"),
        ("--minutes 0", "--minutes: must be from 0.001"),
        ("--name ../x", "give a folder name"),
        (
            "--agent stable_baselines3:PPO",
            "no default search space for stable_baselines3:PPO; give a file with --space",
        ),
        ("--space qlern", "unknown search space 'qlern'; did you mean 'qlearn'?"),
        ("--simulation bulet", "train.simulation: unknown simulator 'bulet'; did you mean 'bullet'?"),
        ("--agent wallfollower --space qlearn", "learn"),
    ],
)
def test_what_does_not_fit_is_one_line_before_anything_is_made(line, words, refused):
    refused(main, line, [words])


def test_without_optuna_it_says_what_to_install(monkeypatch, refused):
    for name in [name for name in sys.modules if name.startswith(("tb2rl.tuning", "tb2rl.commands.tune"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert refused(main, []) == f"error: tune needs Optuna: {install_extra('tune')}\n"


@pytest.mark.slow
def test_two_commands_share_a_study_and_run_no_trial_twice(start_tune, tiny, read_study):
    words = ["--trials", "8", "--seeds", "1", "--fresh", "0", "--workers", "2", "--set", *tiny]
    both = [start_tune(*words), start_tune(*words)]
    said = [process.communicate() for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    each = [re.findall(r"^trial (\d+): ", out, re.MULTILINE) for out, _ in said]
    assert Counter(map(int, each[0] + each[1])) == dict.fromkeys(range(8), 1)
    assert all(each), "one of them did nothing"
    _, trials = read_study(FOLDER)
    assert len({str(trial.params) for trial in trials}) == len(trials) == 8


@pytest.mark.slow
def test_ctrl_c_ends_at_once_and_says_how_to_go_on(start_tune, tiny, read_study):
    long = [word for word in tiny if not word.startswith("train.total")]
    words = ["--trials", "4", "--seeds", "1", "--fresh", "0", "--steps", "100000000", "--set", *long]
    process = start_tune(*words)
    deadline = time.monotonic() + 300
    while not list(Path("runs").rglob("evaluations.jsonl")):
        assert process.poll() is None
        assert time.monotonic() < deadline, "waited 300 s for the first evaluation of a training"
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=30)
    assert (process.returncode, error) == (130, "")
    assert out.splitlines()[-1].startswith(f"stopped; the same command continues {FOLDER}")
    assert {trial.state.name for trial in read_study(FOLDER)[1]} == {"FAIL"}
    assert list((FOLDER / "trials").iterdir()) == []

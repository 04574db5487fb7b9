"""Trials: their files, scores and reproducibility, processes that share a study, and stale trials."""

from __future__ import annotations

import time
from pathlib import Path

import optuna
import pytest
from optuna.pruners import ThresholdPruner
from optuna.trial import TrialState

from tb2rl.core.errors import InputError
from tb2rl.execution.local import LocalExecutor
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.tuning import storage, training
from tb2rl.tuning.page import write_preset
from tb2rl.tuning.selection import TrialEvaluation
from tb2rl.tuning.storage import Heartbeats, open_study
from tb2rl.tuning.training import PruningReporter, TrainingResult, score
from tb2rl.tuning.trials import ask, best_trials, count_trials, run_trials


@pytest.fixture
def untrained(monkeypatch):
    """The parameters of trials whose trainings take no time."""
    trained = []

    def train(_, trial):
        trained.append(trial.params)
        trial.report(0.5, 1)
        return [TrainingResult(trial.params.get("agent.gamma", 0.5), 1.0, 1.0)]

    monkeypatch.setattr(training, "_train", train)
    return trained


def results(study):
    return [(trial.state.name, trial.value, trial.params, trial.intermediate_values) for trial in study.trials]


def test_trials_leave_their_runs_in_the_folder_and_their_preset_makes_the_same_config(make_folder):
    space = {
        "agent.learning_rate.start": {"low": 0.1, "high": 0.9},
        "task.range_bins": {"choices": [[0.7], [0.6, 1.0]]},
    }
    folder = make_folder(space=space, settings={"task.laser_noise": 0.01, "task.robot": "turtlebot3"}, seeds=2)
    with open_study(folder) as study, LocalExecutor(2) as executor:
        assert run_trials(folder, study, 2, executor)
        assert count_trials(study) == {"complete": 2, "pruned": 0, "failed": 0}
        finished = study.trials
    assert [len(trial.user_attrs["good_rates"]) for trial in finished] == [2, 2]
    assert [len(trial.intermediate_values) for trial in finished] == [4, 4]
    assert [str(path) for path in Path("runs").glob("*/*")] == ["runs/tune/it"]
    assert sorted(path.name for path in (folder.path / "trials").iterdir()) == ["0000", "0001"]
    for trial in finished:
        for seed in folder.seeds:
            run = Run.open(folder.run_folder(trial.number, seed))
            assert run.policy_file.parent.name == "best"
            assert run.config.train.seed == seed
            assert run.checkpoints == []
    file = write_preset(folder, finished[0], TrialEvaluation(0, 3, 4, 1.0, "bullet"), 1)
    trained = Run.open(folder.run_folder(0, folder.seeds[0])).config
    again = resolve(preset=str(file), settings={"train.seed": folder.seeds[0], "train.save_freq": 0})
    assert again == trained
    assert (again.task.laser_noise, again.task.robot) == (0.01, "turtlebot3")
    assert file.read_text().splitlines()[1].startswith("# In PyBullet 75.0 % of 4 episodes are good")


@pytest.mark.parametrize("pruner", ["median", "hyperband"])
def test_a_study_that_is_continued_has_the_same_trials_as_one_without_a_break(pruner, make_folder, executor):
    whole, parts = make_folder("whole", pruner=pruner), make_folder("parts", pruner=pruner)
    with open_study(whole) as study:
        run_trials(whole, study, 4, executor)
        expected = results(study)
    for wanted in (1, 3, 4):
        with open_study(parts) as study:
            run_trials(parts, study, wanted, executor)
            found = results(study)
    if pruner == "median":  # Hyperband's brackets depend on the name of the study
        assert found == expected
    assert [params for _, _, params, _ in found] == [params for _, _, params, _ in expected]
    assert len({str(result) for result in expected}) == 4


def test_hyperband_knows_the_rungs_of_earlier_trials(make_folder, executor, untrained):
    folder = make_folder(pruner="hyperband")
    with open_study(folder) as study:
        run_trials(folder, study, 4, executor)
        assert any("completed_rung_0" in trial.system_attrs for trial in study.trials)


def test_processes_that_share_a_study_run_different_trials_and_fail_stale_ones(make_folder, executor, monkeypatch):
    folder = make_folder()
    with open_study(folder) as one, open_study(folder) as other, Heartbeats(folder) as heartbeats:
        first, second = (ask(folder, study, 2, heartbeats) for study in (one, other))
        assert (first.number, second.number) == (0, 1)
        assert first.params != second.params
        assert ask(folder, other, 2, heartbeats) is None
        folder.staging_folder(0).mkdir(parents=True)
    monkeypatch.setattr(storage, "GRACE_PERIOD", 1)
    with open_study(folder) as study, Heartbeats(folder) as heartbeats:
        heartbeats.add(1)
        time.sleep(2.1)  # heartbeats have a resolution of 1 s
        heartbeats.add(1)
        assert ask(folder, study, 2, heartbeats).number == 2
        assert [trial.state.name for trial in study.trials] == ["FAIL", "RUNNING", "RUNNING"]
    assert not folder.staging_folder(0).exists()


def test_a_trial_that_others_failed_meanwhile_is_dropped(make_folder, executor, untrained, monkeypatch, capsys):
    folder, train = make_folder(), training._train
    with open_study(folder) as study, open_study(folder) as other:

        def fail_and_train(inner, trial):
            if trial.number == 0:
                other.tell(0, state=TrialState.FAIL)
            return train(inner, trial)

        monkeypatch.setattr(training, "_train", fail_and_train)
        run_trials(folder, study, 1, executor)
        assert count_trials(study) == {"complete": 1, "pruned": 0, "failed": 1}
    assert "trial 0: failed, because its heartbeats were late" in capsys.readouterr().out


def test_the_time_limit_fails_the_running_trials(make_folder):
    folder = make_folder(settings={"train.total_timesteps": 10**9})
    with open_study(folder) as study, LocalExecutor(1) as executor:
        assert run_trials(folder, study, 2, executor, seconds=0.5) is False
        assert [trial.state.name for trial in study.trials] == ["FAIL"]
    assert list((folder.path / "trials").glob("*")) == []


def test_settings_are_trained_with_once(make_folder, executor, untrained, capsys):
    folder = make_folder(space={"agent.averaging": {"choices": [0.01, 0.1]}})
    with open_study(folder) as study:
        run_trials(folder, study, 8, executor)
        assert sum(count_trials(study).values()) == 8
    assert sorted(params["agent.averaging"] for params in untrained) == [0.01, 0.1]
    assert capsys.readouterr().out.count("the same settings as trial") == 6


def test_settings_that_cannot_be_trained_with_prune_their_trial_only(make_folder, executor, capsys):
    space = {"agent.n_steps": {"choices": [1, 8]}}  # Stable-Baselines3 wants two steps of one environment
    settings = {"agent.batch_size": 8, "train.n_envs": 1, "train.total_timesteps": 64, "train.eval_freq": 0}
    folder = make_folder(space=space, settings=settings, agent="stable_baselines3:PPO")
    with open_study(folder) as study:
        run_trials(folder, study, 4, executor)
        assert count_trials(study)["complete"] == 1
        (reason,) = [trial.user_attrs["reason"] for trial in study.trials if "reason" in trial.user_attrs]
    assert "refuses its settings" in reason
    assert reason in capsys.readouterr().out


def test_a_pruned_training_ends_and_leaves_nothing(make_folder, executor, monkeypatch):
    folder = make_folder()
    monkeypatch.setattr(training, "make_pruner", lambda _: ThresholdPruner(lower=2.0))
    with open_study(folder) as study:
        run_trials(folder, study, 1, executor)
        (trial,) = study.trials
        assert (trial.state.name, len(trial.intermediate_values)) == ("PRUNED", 1)
        assert best_trials(study, 3) == []
    assert list((folder.path / "trials").iterdir()) == []


def test_the_last_evaluation_of_a_training_that_stops_early_stands_for_the_remaining_ones():
    study = optuna.create_study()
    report = PruningReporter(study.ask(), 4, "success")

    class Good:
        good_rate, score = 0.75, (0.5, 100.0)

    report(Good())
    report.fill()
    assert study.trials[0].intermediate_values == dict.fromkeys((1, 2, 3, 4), 0.75)


def test_steps_decide_between_equal_rates_and_nothing_else():
    def of(*rates, used_steps=1.0):
        return score([TrainingResult(rate, 10.0, used_steps) for rate in rates], "success")

    assert of(0.99, 0.97) > of(0.97, 0.97, used_steps=0.0)
    assert of(0.981, used_steps=0.3) > of(0.979, used_steps=0.4)
    assert of(1.0, 0.5) == of(0.75)
    assert score([TrainingResult(0.1, 10.0, 1.0), TrainingResult(0.1, 30.0, 1.0)], "return") == 20.0


def test_a_study_continues_with_the_same_settings_only(make_folder):
    make_folder(seeds=2)
    with pytest.raises(InputError, match=r"begun with another train\.n_envs; give the same, or another --name"):
        make_folder(seeds=2, settings={"train.n_envs": 4})
    with pytest.raises(InputError, match="begun with another seeds, pruner;"):
        make_folder(seeds=1, pruner="none")

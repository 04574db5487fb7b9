"""Trials: their files, scores and reproducibility, processes that share a study, and stale trials."""

import time
from pathlib import Path
from types import SimpleNamespace

import optuna
import pytest
from optuna.pruners import ThresholdPruner
from optuna.trial import TrialState

from tb2rl.core.errors import InputError
from tb2rl.execution.local import LocalExecutor
from tb2rl.runs.config import resolve
from tb2rl.runs.folder import Run
from tb2rl.tuning import storage, training
from tb2rl.tuning.page import write_preset
from tb2rl.tuning.selection import TrialEvaluation
from tb2rl.tuning.storage import heartbeats, open_study
from tb2rl.tuning.training import PruningReporter, TrainingResult, score
from tb2rl.tuning.trials import ask, best_trials, count_trials, run_trials


def test_trials_leave_their_runs_in_the_folder_and_their_preset_makes_the_same_config(make_folder):
    space = {
        "agent.learning_rate.start": {"low": 0.1, "high": 0.9},
        "task.range_bins": {"choices": [[0.7], [0.6, 1.0]]},
    }
    settings = {"task.laser_noise": 0.01, "task.robot": "turtlebot3", "train.eval_freq": 512}
    folder = make_folder(space=space, settings=settings, seeds=2)
    with open_study(folder) as study, LocalExecutor(1) as executor:
        assert run_trials(folder, study, 1, executor)
        assert count_trials(study) == {"complete": 1, "pruned": 0, "failed": 0}
        (trial,) = study.trials
    assert (len(trial.user_attrs["good_rates"]), len(trial.intermediate_values)) == (2, 2)
    assert [str(path) for path in Path("runs").glob("*/*")] == ["runs/tune/it"]
    for seed in folder.seeds:
        run = Run.open(folder.trial_folder(0) / f"seed-{seed}")
        assert run.policy_file.parent.name == "best"
        assert run.config.train.seed == seed
        assert run.checkpoints == []
    file = write_preset(folder, trial, TrialEvaluation(0, 3, 4, 1.0, "bullet"), 1)
    again = resolve(preset=str(file), settings={"train.seed": seed, "train.save_freq": 0})
    assert again == run.config
    assert (again.task.laser_noise, again.task.robot) == (0.01, "turtlebot3")
    assert file.read_text().splitlines()[1].startswith("# In PyBullet 75.0 % of 4 episodes are good")


@pytest.mark.parametrize("pruner", ["median", "hyperband"])
def test_a_study_that_is_continued_has_the_same_trials_as_one_without_a_break(pruner, make_folder, executor, untrained):
    results = []
    for parts in ((4,), (1, 4)):
        folder = make_folder(str(len(parts)), pruner=pruner)
        for wanted in parts:
            with open_study(folder) as study:
                run_trials(folder, study, wanted, executor)
                trials = study.trials
        results.append([(trial.state, trial.value, trial.params, trial.intermediate_values) for trial in trials])
        assert any("completed_rung_0" in trial.system_attrs for trial in trials) == (pruner == "hyperband")
    assert results[0] == results[1]
    assert len({str(result) for result in results[0]}) == 4


@pytest.mark.flaky(reruns=1)  # heartbeats are in real time
def test_processes_that_share_a_study_run_different_trials_and_fail_stale_ones(make_folder, monkeypatch):
    folder = make_folder()
    monkeypatch.setattr(storage, "GRACE_PERIOD", 3)
    with open_study(folder) as one, open_study(folder) as other, heartbeats(folder, {}) as record:
        first, second = ask(folder, one, 2, record), ask(folder, other, 2, record)
        assert (first.number, second.number) == (0, 1)
        assert first.params != second.params
        assert ask(folder, other, 2, record) is None
        folder.trial_folder(0).mkdir(parents=True)
        time.sleep(4.1)  # heartbeats have a resolution of 1 s
        record(second)
        assert ask(folder, one, 2, record).number == 2
        assert [trial.state.name for trial in one.trials] == ["FAIL", "RUNNING", "RUNNING"]
    assert not folder.trial_folder(0).exists()


def test_a_trial_whose_process_was_killed_before_its_first_heartbeat_fails(make_folder):
    def kill(_):
        raise SystemExit

    folder = make_folder()
    with open_study(folder) as study, heartbeats(folder, {}) as record:
        with pytest.raises(SystemExit):
            ask(folder, study, 1, kill)
        assert ask(folder, study, 1, record).number == 1
        assert [trial.state.name for trial in study.trials] == ["FAIL", "RUNNING"]


def test_a_trial_that_others_failed_meanwhile_is_dropped(make_folder, executor, untrained, monkeypatch, capsys):
    folder, train = make_folder(), training._train
    with open_study(folder) as study, open_study(folder) as other:

        def fail_and_train(inner, trial, path):
            if trial.number == 0:
                other.tell(0, state=TrialState.FAIL)
            return train(inner, trial, path)

        monkeypatch.setattr(training, "_train", fail_and_train)
        run_trials(folder, study, 1, executor)
        assert count_trials(study) == {"complete": 1, "pruned": 0, "failed": 1}
    assert "trial 0: failed, because its heartbeats were late" in capsys.readouterr().out


def test_the_time_limit_fails_the_running_trials(make_folder):
    folder = make_folder(settings={"train.total_timesteps": 10**9})
    with open_study(folder) as study, LocalExecutor(1) as executor:
        assert run_trials(folder, study, 2, executor, timeout=0.5) is False
        assert [trial.state.name for trial in study.trials] == ["FAIL"]
    assert list((folder.path / "trials").glob("*")) == []


def test_settings_are_trained_with_once_and_those_that_cannot_be_prune_their_trial_only(make_folder, executor, capsys):
    space = {"agent.n_steps": {"choices": [1, 8]}}  # Stable-Baselines3 wants two steps of one environment
    settings = {"agent.batch_size": 8, "train.n_envs": 1, "train.total_timesteps": 64, "train.eval_freq": 0}
    folder = make_folder(space=space, settings=settings, agent="stable_baselines3:PPO")
    with open_study(folder) as study:
        run_trials(folder, study, 4, executor)
        assert count_trials(study)["complete"] == 1
        (reason,) = [trial.user_attrs["reason"] for trial in study.trials if "reason" in trial.user_attrs]
    out = capsys.readouterr().out
    assert "rejects its settings" in reason
    assert reason in out
    assert out.count("the same settings as trial") == 2


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

    report(SimpleNamespace(good_rate=0.75, score=(0.5, 100.0)))
    report.report_remaining_evaluations()
    assert study.trials[0].intermediate_values == dict.fromkeys((1, 2, 3, 4), 0.75)


def test_steps_decide_between_equal_rates_and_nothing_else():
    def of(*rates, used_step_share=1.0):
        return score([TrainingResult(rate, 10.0, used_step_share) for rate in rates], "success")

    assert of(0.99, 0.97) > of(0.97, 0.97, used_step_share=0.0)
    assert of(0.981, used_step_share=0.3) > of(0.979, used_step_share=0.4)
    assert of(1.0, 0.5) == of(0.75)
    assert score([TrainingResult(0.1, 10.0, 1.0), TrainingResult(0.1, 30.0, 1.0)], "return") == 20.0


def test_a_study_continues_with_the_same_settings_only(make_folder):
    make_folder(seeds=2)
    with pytest.raises(InputError, match=r"created with another train\.n_envs; use the same value"):
        make_folder(seeds=2, settings={"train.n_envs": 4})
    with pytest.raises(InputError, match="created with another seeds, pruner;"):
        make_folder(seeds=1, pruner="none")

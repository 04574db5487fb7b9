"""Trials: what they leave, what they score, who runs them, and what is lost."""

from __future__ import annotations

from pathlib import Path

import optuna
import pytest
from optuna.pruners import ThresholdPruner

from tb2rl.core.errors import InputError
from tb2rl.execution.local import LocalExecutor
from tb2rl.runs.folder import Run
from tb2rl.runs.layers import resolve
from tb2rl.tuning import trials
from tb2rl.tuning.elsewhere import run_elsewhere
from tb2rl.tuning.judging import Judgement
from tb2rl.tuning.page import write_preset
from tb2rl.tuning.storage import open_study
from tb2rl.tuning.trials import Outcome, Reports, best_trials, counts, next_trial, run_trials, score


def results(study):
    return [(trial.state.name, trial.value, trial.params, trial.intermediate_values) for trial in study.trials]


def test_a_study_leaves_its_runs_in_its_folder_alone(search):
    it = search(seeds=2)
    with open_study(it) as study:
        run_trials(it, study, 2)
        assert counts(study) == {"complete": 2, "pruned": 0, "lost": 0}
        assert [len(trial.user_attrs["good_rates"]) for trial in study.trials] == [2, 2]
        assert [len(trial.intermediate_values) for trial in study.trials] == [4, 4]
    assert [str(folder) for folder in Path("runs").glob("*/*")] == ["runs/tune/it"]
    for number in (0, 1):
        for seed in it.seeds:
            run = Run.open(it.run_folder(number, seed))
            assert run.policy_file.parent.name == "best"
            assert run.config.train.seed == seed
            assert run.checkpoints == []


def test_the_same_study_again_comes_to_the_same_whoever_goes_on_with_it(search):
    whole, parts = search("whole"), search("parts")
    with open_study(whole) as study:
        run_trials(whole, study, 4)
        expected = results(study)
    for wanted in (1, 3, 4):
        with open_study(parts) as study:
            run_trials(parts, study, wanted)
    with open_study(parts) as study:
        assert results(study) == expected
        assert len({str(result) for result in expected}) == 4


def test_two_that_share_a_study_have_different_trials_and_wait_for_each_other(search, monkeypatch):
    it, naps = search(), []
    with open_study(it) as one, open_study(it) as other:
        first, second = next_trial(it, one, 2), next_trial(it, other, 2)
        assert (first.trial.number, second.trial.number) == (0, 1)
        assert first.trial.params != second.trial.params

        def nap(seconds):
            naps.append(seconds)
            first.lock.release()  # as if its process had died

        monkeypatch.setattr(trials.time, "sleep", nap)
        third = next_trial(it, other, 2)
        assert third.trial.number == 2
        assert len(naps) == 1, "both were running"
        assert [trial.state.name for trial in other.trials] == ["FAIL", "RUNNING", "RUNNING"]
        assert not it.trial_folder(0).exists()
        for claim in (second, third):
            claim.lock.release()


def test_settings_that_were_tried_are_not_trained_with_again(search, monkeypatch, capsys):
    it, trained = search(space={"agent.averaging": {"choices": [0.01, 0.1]}}), []
    train = trials.train_trial
    monkeypatch.setattr(
        trials, "train_trial", lambda search, trial: [trained.append(trial.params), *train(search, trial)][1:]
    )
    with open_study(it) as study:
        run_trials(it, study, 8)
        assert sum(counts(study).values()) == 8
    assert sorted(params["agent.averaging"] for params in trained) == [0.01, 0.1]
    assert capsys.readouterr().out.count("the same settings as trial") == 6


def test_settings_that_cannot_be_trained_with_cost_their_trial_only(search, capsys):
    space = {"agent.n_steps": {"choices": [1, 8]}}  # Stable-Baselines3 wants two steps of one environment
    settings = {"agent.batch_size": 8, "train.n_envs": 1, "train.total_timesteps": 64, "train.eval_freq": 0}
    it = search(space=space, settings=settings, agent="stable_baselines3:PPO")
    with open_study(it) as study:
        run_trials(it, study, 6)
        assert counts(study)["complete"] == 1
        (reason,) = [trial.user_attrs["reason"] for trial in study.trials if trial.user_attrs.get("reason")]
    assert "refuses its settings" in reason
    assert reason in capsys.readouterr().out


def test_a_pruned_training_ends_and_leaves_nothing(search, monkeypatch):
    it = search()
    monkeypatch.setattr("tb2rl.tuning.storage.pruner", lambda _: ThresholdPruner(lower=2.0))
    with open_study(it) as study:
        run_trials(it, study, 1)
        (trial,) = study.trials
        assert (trial.state.name, len(trial.intermediate_values)) == ("PRUNED", 1)
        assert best_trials(study, 3) == []
    assert not it.trial_folder(0).exists()


def test_evaluations_that_a_good_training_did_not_need_count_as_its_last():
    study = optuna.create_study()
    trial = study.ask()
    report = Reports(trial, 4, "success")

    class Good:
        good_rate, score = 0.75, (0.5, 100.0)

    report(Good())
    report.fill()
    assert study.trials[0].intermediate_values == dict.fromkeys((1, 2, 3, 4), 0.75)


def test_steps_decide_between_equal_rates_and_nothing_else():
    def of(*rates, share=1.0):
        return score([Outcome(rate, 10.0, share) for rate in rates], "success")

    assert of(0.99, 0.97) > of(0.97, 0.97, share=0.0)
    assert of(0.981, share=0.3) > of(0.979, share=0.4)
    assert of(1.0, 0.5) == of(0.75)
    assert score([Outcome(0.1, 10.0, 1.0), Outcome(0.1, 30.0, 1.0)], "return") == 20.0


def test_the_preset_of_a_trial_makes_the_config_that_it_trained_with(search):
    space = {
        "agent.learning_rate.start": {"low": 0.1, "high": 0.9},
        "task.range_bins": {"choices": [[0.7], [0.6, 1.0]]},
    }
    it = search(space=space, settings={"task.laser_noise": 0.01, "task.robot": "turtlebot3"})
    with open_study(it) as study:
        run_trials(it, study, 1)
        (trial,) = study.trials
    file = write_preset(it, trial, Judgement(0, 3, 4, 1.0, "bullet"), 1)
    trained = Run.open(it.run_folder(0, it.seeds[0])).config
    again = resolve(preset=str(file), settings={"train.seed": it.seeds[0], "train.save_freq": 0})
    assert again == trained
    assert (again.task.laser_noise, again.task.robot) == (0.01, "turtlebot3")
    assert file.read_text().splitlines()[1].startswith("# In PyBullet 75.0 % of 4 episodes are good")


def test_a_study_goes_on_with_the_same_settings_only(search):
    search(seeds=2)
    with pytest.raises(InputError, match=r"begun with another train\.n_envs; give the same, or another --name"):
        search(seeds=2, settings={"train.n_envs": 4})
    with pytest.raises(InputError, match="begun with another seeds, pruner;"):
        search(seeds=1, pruner="none")


def test_trials_elsewhere_come_into_the_study_with_their_run_folders(search):
    mine = search(seeds=2)
    with open_study(mine) as study:
        assert run_elsewhere(mine, study, 3, LocalExecutor(2))
        trials = study.get_trials()
    assert [trial.state.name for trial in trials] == ["COMPLETE"] * 3
    for trial in trials:
        assert len(trial.intermediate_values) == 4
        assert len(trial.user_attrs["good_rates"]) == 2
        for seed in mine.seeds:
            assert (mine.run_folder(trial.number, seed) / "best" / "policy.safetensors").is_file()
        with mine.trial_lock(trial.number):  # nobody runs it
            pass
    assert sorted(path.name for path in (mine.folder / "trials").iterdir()) == ["0000", "0001", "0002"]

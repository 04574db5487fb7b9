"""A whole search: from poor settings to good ones, although it is killed in between."""

import signal
import time
from collections import Counter
from functools import partial
from pathlib import Path

import pytest
import yaml

from tb2rl.runs.config import resolve
from tb2rl.tuning import selection

TRIALS, WORKERS = 12, 2
POOR = """
agent:
  name: qlearn  # it hardly learns with these settings, which are outside the search space
  learning_rate: {start: 1.0e-3, end: 1.0e-4}
  gamma: 0.48
  averaging: 3.7e-4
  exploration_fraction: 1.0
  exploration_final_eps: 0.93
train: {simulation: kinematic, total_timesteps: 500000, eval_episodes: 100, eval_steps: 500}
"""


@pytest.mark.slow
@pytest.mark.first
def test_a_search_from_poor_settings_finds_good_ones_although_it_is_killed(start_tune, read_study, monkeypatch):
    words = f"--preset poor.yaml --name found --trials {TRIALS} --workers {WORKERS} --fresh 0".split()
    Path("poor.yaml").write_text(POOR)
    killed, path = start_tune(*words), Path("runs/tune/found")

    def finished() -> dict:
        return {trial.number: trial for trial in read_study(path)[1] if trial.state.name in ("COMPLETE", "PRUNED")}

    while not (path / "study.db").is_file() or len(finished()) < 4:
        assert killed.poll() is None
        time.sleep(1.0)
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    time.sleep(1.0)  # for its processes to see it
    before, again = finished(), start_tune(*words)
    assert (again.communicate()[1], again.returncode) == ("", 0)
    folder, trials = read_study(path)
    assert {number: finished()[number] for number in before} == before
    states = Counter(trial.state.name for trial in trials)
    assert states["COMPLETE"] + states["PRUNED"] == TRIALS
    assert states["FAIL"] <= WORKERS
    assert not states["RUNNING"]
    complete = [folder.settings(trial.params) for trial in trials if trial.state.name == "COMPLETE"]
    best = yaml.safe_load((path / "best.yaml").read_text())
    settings = next(settings for settings in complete if folder.preset(settings) == best)
    assert resolve(preset=str(path / "best.yaml")) == folder.config(settings, seed=0)
    monkeypatch.setattr(selection, "evaluate", partial(selection.evaluate, episodes=40))
    poor_rates = selection.compare(folder, "poor", {}, 1).rates
    best_rates = selection.compare(folder, "best", settings, 3).rates
    assert max(poor_rates) < 0.5
    assert sum(best_rates) / 3 >= 0.9, "of 120 episodes in PyBullet"

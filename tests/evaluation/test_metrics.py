"""A metric is one entry of a list, and everything that shows metrics shows it."""

import json

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tb2rl import evaluate, load, train
from tb2rl.evaluation import metrics
from tb2rl.evaluation.metrics import METRICS, Metric
from tb2rl.viz.page import page
from tb2rl.viz.run_views import group_runs, read_run_view
from tb2rl.zoo.entry import entries


@pytest.fixture
def turning(monkeypatch) -> Metric:
    """A metric of a user."""
    turning = Metric("turns", "turns taken", "steps", lambda episode: float((episode.actions > 0).sum()))
    monkeypatch.setattr(metrics, "METRICS", (*METRICS, turning))
    return turning


@pytest.fixture
def run(turning, tmp_path):
    """The folder of a training with one evaluation."""
    settings = {"train.simulation": "kinematic", "train.eval_simulation": "kinematic", "train.eval_episodes": 2}
    train("qlearn", settings=settings, folder=tmp_path / "run", total_timesteps=64, eval_freq=32, eval_steps=10)
    return tmp_path / "run"


def test_tables_json_tensorboard_and_pages_show_a_new_metric(run):
    evaluation = evaluate(load(run), episodes=2, steps=10, simulation="kinematic")
    turns = evaluation.summary()["mean_turns"]
    assert turns == sum((episode.actions > 0).sum() for episode in evaluation.episodes) / 2
    assert f"{turns:.1f}" in next(line for line in repr(evaluation).splitlines() if line.startswith("turns taken"))
    assert "mean_turns" in json.loads((run / "evaluations.jsonl").read_text().splitlines()[0])
    events = EventAccumulator(str(run / "tensorboard")).Reload()
    assert "eval/mean_turns" in events.Tags()["scalars"]
    assert "<th>turns taken [steps]</th>" in page(group_runs([read_run_view(run, "run")]))


def test_cards_of_the_zoo_show_a_new_metric(turning, monkeypatch):
    (entry,) = (each for each in entries() if each.name == "maze-loop-qlearn")
    monkeypatch.setitem(entry.summary, "mean_turns", 4.0)
    monkeypatch.setitem(entry.summary, "std_turns", 1.0)
    assert ("turns taken", "4.0", "± 1.0 steps") in entry.metric_rows


def test_a_mean_of_counts_is_short():
    (visited,) = (metric for metric in METRICS if metric.label == "visited")
    assert [visited.format(figure) for figure in (48.0, 19 / 3)] == ["48", "6.3"]

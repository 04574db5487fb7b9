"""The benchmark measures what it says, and the compiled code uses the processors that there are."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest

from tb2rl import benchmark
from tb2rl.commands import benchmark as work
from tb2rl.commands import rates
from tb2rl.commands.benchmark import PARTS, learners
from tb2rl.commands.rates import Figure
from tb2rl.core.processes import processors
from tb2rl.simulation import InitialState
from tb2rl.simulation.kinematic.simulator import KinematicSimulator
from tb2rl.simulation.kinematic.threads import THREADS


@pytest.fixture
def brief(monkeypatch):
    """Less of everything."""
    monkeypatch.setattr(rates, "BEAMS", (6,))
    monkeypatch.setattr(rates, "ROBOTS", (1, 100))
    monkeypatch.setattr(rates, "ENVIRONMENTS", 2)
    monkeypatch.setattr(work, "learners", lambda: ["qlearn"])


def test_the_table_has_a_figure_for_everything(brief, tmp_path, capsys):
    benchmark.main(["physics", "twin", "--seconds", "0.5", "--json", str(tmp_path / "b.json")])
    tree = json.loads((tmp_path / "b.json").read_text())
    values = {figure["name"]: figure["value"] for figure in tree["figures"]}
    assert "processors" in tree["machine"]
    assert 1 < values["PyBullet, 6 beams: step / bare stepping"] < 3
    assert values["PyBullet, 6 beams: bare stepping in it"] > 0.05  # [ms]
    for num_envs in (1, 100):
        assert values[f"twin, {num_envs} robots, 6 beams: step / bare kernel"] > 1
    assert values["twin, 100 robots, 6 beams: step"] > values["PyBullet, 6 beams: step"]
    together, alone = "PyBullet, 2 environments in parallel processes", values["PyBullet, one environment alone"]
    shares = [value for name, value in values.items() if name.startswith("PyBullet, 2 in parallel / (")]
    assert shares == [pytest.approx(values[together] / alone / processors(), rel=0.5)]
    printed = capsys.readouterr().out
    assert tree["machine"].split(",")[0] in printed
    assert all(name in printed for name in values)


@pytest.mark.slow
def test_the_time_to_trained_is_the_one_of_the_first_evaluation_that_passes(brief, tmp_path):
    benchmark.main(["training", "trained", "--seeds", "2", "--json", str(tmp_path / "b.json")])
    figures = [Figure(**figure) for figure in json.loads((tmp_path / "b.json").read_text())["figures"]]
    values = {figure.name: figure.value for figure in figures}
    times = [values[f"qlearn in kinematic, seed {seed}: trained after"] for seed in (0, 1)]
    assert values["qlearn in kinematic: trained, median of 2 seeds"] == pytest.approx(np.mean(times))
    assert all(0.1 < seconds < 120 for seconds in times)
    assert all(values[f"qlearn in kinematic, seed {s}: failure-free, standard evaluation"] >= 95 for s in (0, 1))
    assert values["training, qlearn in kinematic"] > 10 * values["training, qlearn in bullet"]


def test_it_knows_every_agent_that_learns():
    assert learners() == ["dqn", "ppo", "qlearn", "recurrent_ppo"], "sac and td3 cannot do the task `maze`"


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("twn", ["twn", "did you mean 'twin'", *PARTS]),
        ("--seconds 0", ["--seconds", "0.0"]),
        ("--seeds 0", ["--seeds", "0"]),
        ("--in gazebo", ["gazebo", "kinematic", "bullet"]),
        ("--json nowhere/b.json", ["nowhere/b.json"]),
    ],
)
def test_bad_input_is_refused_before_anything_is_measured(line, named, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(work, "PARTS", dict.fromkeys(PARTS, lambda conditions: pytest.fail("measured")))
    with pytest.raises(SystemExit) as stopped:
        benchmark.main(line.split())
    message = capsys.readouterr().err
    assert stopped.value.code == 2
    assert message.count("\n") == 1
    assert [part for part in named if part not in message] == []


@pytest.mark.skipif(THREADS < 2, reason="one processor has nothing to share")
def test_threads_share_the_work_of_a_batch(make_setup):
    spec, rng = make_setup("loop", beams=36), np.random.default_rng(0)
    simulation, start = KinematicSimulator(spec, 4096), InitialState.default(spec, 4096)
    start.pose[:] = spec.worlds[0].random_poses(rng, 4096, 0.6)
    simulation.reset(start, rng)
    commands = np.tile([0.05, 1.0], (4096, 1))
    simulation.step(commands, 0.2)  # starts the threads
    mine, all_of_us = time.thread_time(), time.process_time()
    for _ in range(50):
        simulation.step(commands, 0.2)
    mine, all_of_us = time.thread_time() - mine, time.process_time() - all_of_us
    assert mine < 0.8 * all_of_us  # of processor time, however busy the machine is

"""The command `benchmark`."""

import json
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tb2rl import benchmark
from tb2rl.commands import benchmark as work
from tb2rl.commands.benchmark import PARTS
from tb2rl.core.processes import processors
from tb2rl.core.threads import THREADS
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.simulation import InitialState, bullet
from tb2rl.simulation.kinematic.simulator import KinematicSimulator


@pytest.fixture
def measured(monkeypatch, workdir):
    """A function that runs a small benchmark and returns its values by name."""
    monkeypatch.setattr(work, "BEAM_COUNTS", (6,))
    monkeypatch.setattr(work, "ENV_COUNTS", (1, 100))
    monkeypatch.setattr(work, "NUM_PARALLEL", 2)
    monkeypatch.setattr(work, "learners", lambda: ["qlearn"])

    def run(*arguments: str) -> dict[str, float]:
        benchmark.main([*arguments, "--json", "b.json"])
        tree = json.loads((workdir / "b.json").read_text())
        assert "processors" in tree["machine"]
        return {figure["name"]: figure["value"] for figure in tree["figures"]}

    return run


def test_the_kinematic_simulator_is_measured_without_pybullet(measured, monkeypatch, capsys):
    monkeypatch.setattr(bullet, "SIMULATOR", replace(bullet.SIMULATOR, unavailable=lambda: "is not installed"))
    values = measured("kinematic", "--seconds", "0.01")
    assert values["kinematic, 100 x 6 beams: step / bare kernel"] > 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in values)


@pytest.mark.slow
@pytest.mark.flaky(reruns=1)  # it compares processor times
def test_each_physics_is_measured_alone_and_in_parallel(measured, monkeypatch):
    rates, measure_rate = dict[str, list[float]](), work._measure_rate

    def record(env, steps) -> float:
        rate = measure_rate(env, steps)
        rates.setdefault("MuJoCo" if "mujoco" in type(env.loop.simulator).__module__ else "PyBullet", []).append(rate)
        return rate

    monkeypatch.setattr(work, "_measure_rate", record)
    values = measured("physics", "--seconds", "0.5")
    assert 1 < values["PyBullet, 6 beams: step / bare stepping"] < 3
    assert values["PyBullet, 6 beams: bare stepping in it"] > 0.05  # [ms]
    assert values["MuJoCo, 6 beams: step"] > values["PyBullet, 6 beams: step"]
    for title, both in rates.items():
        parallel, alone = np.array(both).reshape(-1, 2).T
        assert values[f"{title}, 2 environments in parallel"] == pytest.approx(np.median(parallel))
        assert values[f"{title}, one environment alone"] == pytest.approx(np.median(alone))
        shares = [value for name, value in values.items() if name.startswith(f"{title}, 2 in parallel / (")]
        assert shares == [pytest.approx(np.median(parallel / alone) / processors())]


@pytest.mark.slow
@pytest.mark.flaky(reruns=1)  # it compares times
def test_the_time_to_trained_ends_with_the_first_evaluation_that_passes(measured, monkeypatch):
    monkeypatch.setattr(work, "evaluate", partial(evaluate, simulation="kinematic"))
    monkeypatch.setattr(work, "_MAX_PHYSICS_STEPS", 5_000)
    values = measured("training", "trained", "--seeds", "2")
    times = [values[f"qlearn in kinematic, seed {seed}: trained after"] for seed in (0, 1)]
    assert values["qlearn in kinematic: trained, median of 2 seeds"] == pytest.approx(np.mean(times))
    assert all(0.1 < seconds < 120 for seconds in times)
    assert all(values[f"qlearn in kinematic, seed {s}: failure-free, standard evaluation"] >= 95 for s in (0, 1))
    assert values["training, qlearn in kinematic"] > 10 * values["training, qlearn in bullet"]


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("kinematics", ["kinematics", "did you mean 'kinematic'", *PARTS]),
        ("--in gazebo", ["gazebo", "kinematic", "bullet"]),
        ("--json nowhere/b.json", ["nowhere/b.json"]),
    ],
)
def test_wrong_input_is_refused_before_anything_is_measured(line, named, refused, monkeypatch):
    monkeypatch.setattr(work, "PARTS", dict.fromkeys(PARTS, lambda options: pytest.fail("measured")))
    refused(benchmark.main, line, named)


@pytest.mark.skipif(THREADS < 2, reason="one processor has nothing to share")
def test_threads_share_the_work_of_many_environments(make_spec):
    spec, rng = make_spec("loop", beams=36), np.random.default_rng(0)
    simulator, initial_state = KinematicSimulator(spec, 4096), InitialState.default(spec, 4096)
    initial_state.pose[:] = spec.worlds[0].sample_poses(rng.random((4096, 4)), 0.6)
    simulator.reset(initial_state, rng)
    commands = np.tile([0.05, 1.0], (4096, 1))
    simulator.step(commands, 0.2)  # starts the threads
    this_thread, all_threads = time.thread_time(), time.process_time()
    for _ in range(20):
        simulator.step(commands, 0.2)
    this_thread, all_threads = time.thread_time() - this_thread, time.process_time() - all_threads
    assert this_thread < 0.8 * all_threads  # processor time, which does not depend on the load of the machine

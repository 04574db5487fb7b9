"""Classes of a script or a notebook's cell are trained with, and loaded where they are still defined."""

import re
import subprocess
import sys
import warnings
from pathlib import Path
from textwrap import dedent

import pytest

from tb2rl import load, train
from tb2rl.core.errors import InputError
from tb2rl.core.plugins import import_object
from tb2rl.runs.config import resolve

QUICKSTART = Path(__file__).parent.parent / "zoo" / "quickstart.ipynb"
MINE = """
    from dataclasses import dataclass

    from stable_baselines3 import A2C

    import tb2rl
    from tb2rl.sensors import Sensor
    from tb2rl.tasks.wander import Wander

    class Speed(Sensor):
        name, unit, low, high = "speed", "m/s", -1.0, 1.0

        def read(self, robot_state):
            return robot_state.twist[:, :1]

    @dataclass(frozen=True)
    class Hurry(Wander):
        hurry: float = 2.0

        def sensors(self, spec):
            return (*super().sensors(spec), Speed())

    class Mine(A2C):
        pass
    """
USED = """
    few = dict(n_envs=2, simulation="bullet", total_timesteps=32, eval_freq=32, eval_episodes=2, eval_steps=5)
    settings = {"agent.n_steps": 8, "task.beams": 9}
    trained = tb2rl.train(Mine, Hurry, folder="run", settings=settings, **few)
    policy = tb2rl.load("run")
    assert type(trained) is type(policy) is Mine
    assert type(policy.trained_with.task) is Hurry
    assert policy.observation_space.names == ("laser",) * 9 + ("speed",)
    shared = tb2rl.evaluate(policy, episodes=2, steps=5, workers=2)
    assert shared.summary() == tb2rl.evaluate(policy, episodes=2, steps=5, workers=1).summary()
    print("names", policy.trained_with.agent_name, policy.trained_with.task_name)
    """
SAYS = "names __main__:Mine __main__:Hurry"


def assert_needs_a_file(run: Path) -> None:
    """A program without the classes of a run cannot load it, and says what to do."""
    with pytest.raises(InputError, match=r"^[^\n]*save Mine of [^\n]* in a file, and use the reference module:Mine$"):
        load(run)


def test_classes_of_main_are_trained_with(tmp_path, monkeypatch):
    defined = {"__name__": "__main__"}
    exec(dedent(MINE), defined)
    for name in ("Mine", "Hurry"):
        monkeypatch.setattr(sys.modules["__main__"], name, defined[name], raising=False)
    few = {"n_envs": 2, "simulation": "kinematic", "total_timesteps": 32, "eval_freq": 0}
    trained = train(defined["Mine"], defined["Hurry"], folder=tmp_path / "run", settings={"agent.n_steps": 8}, **few)
    assert type(load(tmp_path / "run")) is type(trained) is defined["Mine"]
    assert type(trained.trained_with.task) is defined["Hurry"]
    monkeypatch.undo()
    assert_needs_a_file(tmp_path / "run")


@pytest.mark.slow
def test_a_script_trains_with_its_own_classes_in_processes(tmp_path):
    (tmp_path / "script.py").write_text(dedent(MINE) + dedent(USED))  # without a guard against being run again
    command = [sys.executable, "-W", "ignore", "script.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=100)
    assert (done.returncode, done.stdout.splitlines()[-1:]) == (0, [SAYS]), done.stderr
    assert_needs_a_file(tmp_path / "run")


@pytest.mark.slow
def test_the_quickstart_runs_from_top_to_bottom_and_trains_with_the_task_of_its_cell(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(QUICKSTART, as_version=4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Jupyter's own packages
        from nbclient import NotebookClient

        NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", ())]
    assert sum("image/png" in kinds for kinds in shown) == 3, "the robot, the curve, the paths of one's own task"
    assert any(re.match(r"'trained in \d+ s; .* \d+ % of", kinds.get("text/plain", "")) for kinds in shown)
    assert (tmp_path / "drive.mp4").stat().st_size > 50_000
    assert len(list(tmp_path.glob("runs/quickstart/*/best/policy.safetensors"))) == 2


def test_only_existing_classes_of_main_are_found_and_nothing_is_run(monkeypatch):
    for function in ("run", "__getattr__"):
        monkeypatch.setattr(sys.modules["__main__"], function, lambda *_: pytest.fail("it was run"), raising=False)
    for name in ("Nothing", "run", "__getattr__", ""):
        with pytest.raises(InputError, match="cannot import '__main__:"):
            import_object(f"__main__:{name}")


def test_a_class_whose_reference_means_another_one_is_refused():
    class Wander:
        pass

    Wander.__module__, Wander.__qualname__ = "tb2rl.tasks.wander", "Wander"
    with pytest.raises(InputError, match="means another class by now"):
        resolve(task=Wander)

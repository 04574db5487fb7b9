"""Without PyBullet the kinematic simulator does all work, and every figure names its simulator."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import tb2rl
from tb2rl import benchmark
from tb2rl.core.errors import InputError
from tb2rl.simulation import default_simulator
from tb2rl.simulation.bullet import unavailable
from tb2rl.viz.film import FilmOptions, film
from tb2rl.viz.window import Window
from tb2rl.zoo import __main__ as zoo

CHECKOUT = Path(__file__).parent.parent
MISSING = "import sys\nsys.modules['pybullet'] = None\n"
BROKEN = "raise ImportError('pybullet.so: undefined symbol: _ZN7btClockD1Ev\\n')\n"
REASONS = {
    MISSING: "is not installed: pip install pybullet",
    BROKEN: "is installed, but importing it raises ImportError: pybullet.so: undefined symbol: _ZN7btClockD1Ev",
}


@pytest.fixture(params=[MISSING, BROKEN], ids=["missing", "broken"])
def reason(request, tmp_path, monkeypatch):
    """Why PyBullet cannot be imported in this process."""
    (tmp_path / "pybullet.py").write_text(request.param)
    monkeypatch.syspath_prepend(tmp_path)
    for module in ("pybullet", "tb2rl.simulation.bullet.client"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    if request.param == MISSING:
        monkeypatch.setitem(sys.modules, "pybullet", None)
    for cached in (unavailable, default_simulator):
        cached.cache_clear()
    yield REASONS[request.param]
    for cached in (unavailable, default_simulator):
        cached.cache_clear()


def test_anything_that_needs_pybullet_says_so_in_one_line(reason, tmp_path, monkeypatch, capsys):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("DISPLAY", ":99")
    scene = tb2rl.make_env(simulation="kinematic").scene
    calls = {
        'simulation="kinematic"': tb2rl.make_env,
        "a training": lambda: tb2rl.train(total_timesteps=8, n_envs=2, folder="run"),
        "chase": lambda: film("zoo:maze-loop-dqn", "film.gif", options=FilmOptions(camera="chase", steps=2)),
        "window": lambda: Window(scene),
    }
    for word, call in calls.items():
        with pytest.raises(InputError, match=r"^[^\n]*needs PyBullet, which ") as refused:
            call()
        assert word in str(refused.value)
        assert reason in str(refused.value)
    for main, arguments in ((benchmark.main, ["physics"]), (zoo.main, ["check"])):
        with pytest.raises(SystemExit) as stopped:
            main(arguments)
        error = capsys.readouterr().err
        assert (stopped.value.code, error.count("\n")) == (2, 1)
        assert reason in error
    assert list(Path.cwd().iterdir()) == []


@pytest.fixture
def run(request, tmp_path):
    """A function that runs Python and all its child processes without PyBullet, and returns the output."""
    site, folder = tmp_path / "site", tmp_path / "here"
    site.mkdir()
    folder.mkdir()
    code = getattr(request, "param", MISSING)
    (site / ("sitecustomize.py" if code == MISSING else "pybullet.py")).write_text(code)

    def call(*arguments: str) -> str:
        env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(CHECKOUT)]), "DISPLAY": ":99"}
        command = [sys.executable, *arguments]
        done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    call.folder = folder
    return call


@pytest.mark.slow
@pytest.mark.parametrize("run", [MISSING, BROKEN], ids=["missing", "broken"], indirect=True)
def test_an_evaluation_names_its_simulator(run, request):
    command = "-m tb2rl.evaluate zoo:maze-loop-dqn --episodes 2 --steps 5 --workers 2 --json figures.json"
    shown = run(*command.split())
    assert shown.count("not PyBullet's") == 1
    assert (REASONS[BROKEN] in shown) == ("broken" in request.node.name)
    assert json.loads((run.folder / "figures.json").read_text())["simulation"] == "kinematic"


@pytest.mark.slow
def test_training_evaluation_report_and_film_work(run):
    training = "--simulation kinematic --n-envs 32 --total-timesteps 4096 --name mine --set train.eval_episodes=2"
    shown = run("-m", "tb2rl.train", *training.split(), "train.eval_steps=50")
    assert shown.count("not PyBullet's") == 1
    folder = run.folder / "runs/maze/qlearn/mine"
    evaluations = [json.loads(line) for line in (folder / "evaluations.jsonl").read_text().splitlines()]
    evaluations.append(json.loads((folder / "evaluation.json").read_text()))
    assert {each["simulation"] for each in evaluations} == {"kinematic"}
    run("-m", "tb2rl.report", str(folder), "--out", "page.html")
    page = (run.folder / "page.html").read_text(encoding="utf-8")
    assert "not in PyBullet" in page
    assert "in PyBullet's physics" not in page
    run("-m", "tb2rl.play", str(folder), "--steps", "5")  # a film, although there is a display
    assert (run.folder / "mine.mp4").is_file()


@pytest.mark.slow
def test_the_first_cell_of_the_notebook_works(run):
    cells = json.loads((CHECKOUT / "zoo" / "quickstart.ipynb").read_text(encoding="utf-8"))["cells"]
    first = next("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert run("-c", f"{first}\nprint(env._steps)") == "200\n"

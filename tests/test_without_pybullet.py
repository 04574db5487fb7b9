"""Where PyBullet is missing or broken, the fast twin does everything, and no figure passes for one of PyBullet's."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import tb2rl
from tb2rl.core.errors import InputError
from tb2rl.simulation import bullet_trouble

CHECKOUT = Path(__file__).parent.parent
REFUSED = """
import tb2rl
from tb2rl.core.errors import InputError

def refusal(function, *arguments, **named):
    try:
        function(*arguments, **named)
    except InputError as error:
        print(error)

from tb2rl import benchmark
from tb2rl.viz.film import film
from tb2rl.viz.window import Window
from tb2rl.zoo import __main__ as zoo

refusal(tb2rl.make_env)
refusal(tb2rl.train, total_timesteps=8, n_envs=2, folder="run")
refusal(film, "zoo:maze-loop-dqn", "film.gif", camera="chase", steps=2)
refusal(Window, tb2rl.make_env(simulation="kinematic").scene)
for main, words in ((benchmark.main, ["physics"]), (zoo.main, ["check"])):
    try:
        main(words)
    except SystemExit as stopped:
        print(stopped.code)
"""


MISSING = ("sitecustomize.py", "import sys\nsys.modules['pybullet'] = None\n")
BROKEN = ("pybullet.py", "raise ImportError('pybullet.so: undefined symbol: _ZN7btClockD1Ev\\n')\n")
UNDEFINED = "is installed, but importing it raises ImportError: pybullet.so: undefined symbol: _ZN7btClockD1Ev"


@pytest.fixture(params=[MISSING])
def run(request, tmp_path):
    """A function that runs Python without PyBullet, in every process that it starts; what was printed, and status."""
    site = tmp_path / "site"
    site.mkdir()
    (site / request.param[0]).write_text(request.param[1])
    folder = tmp_path / "here"
    folder.mkdir()

    def call(*arguments: str) -> subprocess.CompletedProcess[str]:
        path = os.pathsep.join([str(site), str(CHECKOUT)])
        env = {**os.environ, "PYTHONPATH": path, "DISPLAY": ":99"}
        command = [sys.executable, *arguments]
        return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)

    call.folder = folder
    return call


def printed(done: subprocess.CompletedProcess[str]) -> str:
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


@pytest.mark.slow
def test_an_evaluation_drives_in_the_twin_and_says_so(run):
    command = "-m tb2rl.evaluate zoo:maze-loop-dqn --episodes 2 --steps 5 --workers 2 --json figures.json"
    assert printed(run(*command.split())).count("driven in the fast twin") == 1
    assert json.loads((run.folder / "figures.json").read_text())["simulation"] == "kinematic"


def test_what_needs_pybullet_ends_in_one_line_that_says_what_to_install(run):
    done = run("-c", REFUSED)
    lines = [*done.stdout.splitlines(), *done.stderr.splitlines()]
    messages = [line for line in lines if line != "2"]
    assert (len(messages), lines.count("2"), done.returncode) == (6, 2, 0), lines
    for message, word in zip(
        messages, ('simulation="kinematic"', "a training", "chase", "window", "physics", "zoo"), strict=True
    ):
        assert word in message
        assert "needs PyBullet, which is not installed: pip install pybullet" in message
    assert list(run.folder.iterdir()) == []


def test_what_needs_pybullet_says_why_an_installed_one_cannot_be_imported(tmp_path, monkeypatch):
    (tmp_path / BROKEN[0]).write_text(BROKEN[1])
    monkeypatch.syspath_prepend(tmp_path)
    for module in ("pybullet", "tb2rl.simulation.bullet.client"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setattr("tb2rl.simulation.bullet_trouble", bullet_trouble.__wrapped__)  # without its cache
    with pytest.raises(InputError, match=f'simulation="bullet" .* needs PyBullet, which {UNDEFINED}$'):
        tb2rl.make_env()


@pytest.mark.slow
@pytest.mark.parametrize("run", [BROKEN], indirect=True)
def test_an_evaluation_in_the_place_of_a_broken_pybullet_says_why(run):
    command = "-m tb2rl.evaluate --agent random --episodes 1 --steps 2 --workers 1"
    assert f"driven in the fast twin, since PyBullet {UNDEFINED}: these are not" in printed(run(*command.split()))


@pytest.mark.slow
def test_a_training_with_its_evaluations_a_film_and_a_report_work_in_the_twin(run):
    training = "--simulation kinematic --n-envs 32 --total-timesteps 4096 --name mine --set train.eval_episodes=2"
    said = printed(run("-m", "tb2rl.train", *training.split(), "train.eval_steps=50"))
    assert "in the fast twin: 100 episodes" in said
    assert said.count("driven in the fast twin") == 1
    folder = run.folder / "runs/maze/qlearn/mine"
    on_the_way = [json.loads(line) for line in (folder / "evaluations.jsonl").read_text().splitlines()]
    kept = json.loads((folder / "evaluation.json").read_text())
    assert {note["simulation"] for note in [*on_the_way, kept]} == {"kinematic"}
    printed(run("-m", "tb2rl.report", str(folder), "--out", "page.html"))
    page = (run.folder / "page.html").read_text(encoding="utf-8")
    assert "was driven in the fast twin, not in PyBullet" in page
    assert "in PyBullet's physics" not in page
    said = printed(run("-m", "tb2rl.play", str(folder), "--steps", "5"))  # a film, despite the display
    assert "driven in the fast twin" in said
    assert (run.folder / "mine.mp4").is_file()
    assert "twin, 1 robots" in printed(run("-m", "tb2rl.benchmark", "twin", "--seconds", "0.01"))


@pytest.mark.slow
def test_the_notebook_loads_and_drives(run):
    cells = json.loads((CHECKOUT / "zoo" / "quickstart.ipynb").read_text(encoding="utf-8"))["cells"]
    first = next("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert printed(run("-c", f"{first}\nprint(env._steps)")) == "200\n"

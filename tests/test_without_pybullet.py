"""Without PyBullet MuJoCo is the physics; without both the kinematic simulator does all work. Figures name theirs."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import tb2rl
from tb2rl import benchmark
from tb2rl.core.errors import InputError
from tb2rl.simulation.simulator import default_physics, default_simulator, import_problem
from tb2rl.viz.film import FilmOptions, film
from tb2rl.zoo import __main__ as zoo

CHECKOUT = Path(__file__).parent.parent
MISSING = "import sys\nsys.modules['pybullet'] = None\n"
NO_PHYSICS = MISSING + "sys.modules['mujoco'] = None\n"
BROKEN = "raise ImportError('pybullet.so: undefined symbol: _ZN7btClockD1Ev\\n')\n"
REASONS = {
    MISSING: "is not installed: pip install pybullet",
    BROKEN: "is installed, but importing it raises ImportError: pybullet.so: undefined symbol: _ZN7btClockD1Ev",
}


def clear_caches():
    """Forget which simulators can run here."""
    for cached in (import_problem, default_simulator):
        cached.cache_clear()


@pytest.fixture(params=[MISSING, BROKEN], ids=["missing", "broken"])
def reason(request, tmp_path_factory, monkeypatch):
    """Why PyBullet cannot be imported in this process."""
    site = tmp_path_factory.mktemp("site")
    (site / "pybullet.py").write_text(request.param)
    monkeypatch.syspath_prepend(site)
    for module in ("pybullet", "tb2rl.simulation.bullet.client"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    if request.param == MISSING:
        monkeypatch.setitem(sys.modules, "pybullet", None)
    clear_caches()
    yield REASONS[request.param]
    clear_caches()


def test_anything_that_needs_pybullet_says_so_in_one_line(reason, workdir, refused):
    calls = {
        'simulation="mujoco"': lambda: tb2rl.make_env(simulation="bullet"),
        "chase": lambda: film("zoo:maze-loop-dqn", "film.gif", options=FilmOptions(camera="chase", steps=2)),
    }
    for word, call in calls.items():
        with pytest.raises(InputError, match=rf"^[^\n]*{word}[^\n]*needs PyBullet, which {re.escape(reason)}"):
            call()
    refused(zoo.main, "check --simulation bullet", [reason])
    assert list(workdir.iterdir()) == []


def test_without_pybullet_mujoco_is_the_physics(reason, workdir):
    assert (default_physics().name, default_simulator().name) == ("mujoco", "mujoco")
    policy = tb2rl.train(total_timesteps=64, n_envs=2, folder="run")
    assert policy.trained_with.train.simulation == "mujoco"
    assert tb2rl.evaluate(policy, episodes=1, steps=20).simulation == "mujoco"


def test_without_any_physics_what_needs_it_says_so_in_one_line(reason, monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    clear_caches()
    assert default_simulator().name == "kinematic"
    calls = {
        'simulation="kinematic"': tb2rl.make_env,
        "a training": lambda: tb2rl.train(total_timesteps=8, n_envs=2, folder="run"),
    }
    for word, call in calls.items():
        with pytest.raises(InputError, match=rf"^[^\n]*{word}[^\n]*needs PyBullet, which {re.escape(reason)}"):
            call()
    refused(zoo.main, "check", [reason])
    refused(benchmark.main, "physics", [reason])
    with pytest.raises(InputError, match="needs MuJoCo, which is not installed: pip install mujoco-core"):
        tb2rl.make_env(simulation="mujoco")


@pytest.fixture
def run(workdir, tmp_path_factory):
    """A function that runs Python and all its child processes without physics, and returns the output."""

    def call(*arguments: str, code: str = NO_PHYSICS) -> str:
        site = tmp_path_factory.mktemp("site")
        if code == BROKEN:
            (site / "mujoco.py").write_text(code)
        (site / ("pybullet.py" if code == BROKEN else "sitecustomize.py")).write_text(code)
        env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(CHECKOUT)])}
        done = subprocess.run([sys.executable, *arguments], env=env, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    return call


@pytest.mark.slow
def test_training_evaluation_report_film_and_the_notebooks_first_cell_work(run, workdir):
    training = "--simulation kinematic --n-envs 32 --total-timesteps 4096 --name mine --set train.eval_episodes=2"
    shown = run("-m", "tb2rl.train", *training.split(), "train.eval_steps=50", code=BROKEN)
    assert shown.count("not PyBullet's") == 1
    assert REASONS[BROKEN] in shown
    folder = workdir / "runs/maze/qlearn/mine"
    evaluations = [json.loads(line) for line in (folder / "evaluations.jsonl").read_text().splitlines()]
    evaluation = "-m tb2rl.evaluate runs/maze/qlearn/mine --episodes 2 --steps 5 --workers 2 --json figures.json"
    assert run(*evaluation.split()).count("not PyBullet's") == 1
    evaluations += [json.loads(file.read_text()) for file in (folder / "evaluation.json", workdir / "figures.json")]
    assert {each["simulation"] for each in evaluations} == {"kinematic"}
    run("-m", "tb2rl.report", str(folder), "--out", "page.html")
    page = (workdir / "page.html").read_text(encoding="utf-8")
    assert "The greedy policy in the kinematic simulator" in page
    assert "not in physics" in page
    run("-m", "tb2rl.play", str(folder), "--steps", "5", "--video", "mine.mp4")
    assert (workdir / "mine.mp4").is_file()
    cells = json.loads((CHECKOUT / "zoo" / "quickstart.ipynb").read_text(encoding="utf-8"))["cells"]
    first = next("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert run("-c", f"{first}\nprint(len(env.path))") == "201\n"


@pytest.mark.slow
def test_the_readme_s_training_evaluation_and_report_work_in_mujoco_alone(run, workdir):
    training = "-m tb2rl.train --n-envs 4 --total-timesteps 512 --name mine --set train.eval_episodes=2"
    run(*training.split(), "train.eval_steps=50", code=MISSING)
    folder = workdir / "runs/maze/qlearn/mine"
    assert json.loads((folder / "evaluation.json").read_text())["simulation"] == "mujoco"
    shown = run("-m", "tb2rl.evaluate", str(folder), "--episodes", "2", "--steps", "5", code=MISSING)
    assert "MuJoCo" in shown
    run("-m", "tb2rl.report", str(folder), "--out", "page.html", code=MISSING)
    assert "The greedy policy in MuJoCo" in (workdir / "page.html").read_text(encoding="utf-8")

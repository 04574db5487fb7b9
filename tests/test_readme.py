"""Pages: their files are saved, their commands and examples run, their errors compared, their links followed."""

import re
import runpy
import shlex
import signal
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import pytest

from tb2rl.__main__ import COMMANDS
from tb2rl.training.statistics import ADVICE

CHECKOUT = Path(__file__).parent.parent
OF_ROOMS = [str(page.relative_to(CHECKOUT)) for page in sorted((CHECKOUT / "tb2rl").rglob("README.md"))]
DOCS = [str(page.relative_to(CHECKOUT)) for page in sorted((CHECKOUT / "docs").rglob("*.md"))]
PAGES = ["README.md", "FROM_ROS.md", "CONTRIBUTING.md", *DOCS, *OF_ROOMS]
PAGES += ["agents/README.md", "configs/README.md", "zoo/README.md"]
SHORTER = {  # arguments appended to a command to shorten it
    "train": "--simulation kinematic --n-envs 32 --total-timesteps 256 --eval-freq 0 --no-evaluation --no-progress",
    "evaluate": "--episodes 1 --steps 3 --workers 1",
    "play": "--steps 3",
}
RESUMED = "--total-timesteps 4096 --no-evaluation --no-progress"
# They take long, or need ROS, a bag or an optional library.
ONLY_PARSED = {
    "calibrate",
    "mlflow",
    "ros",
    "task.robot=my_robot.yaml",
    "--seeds",
    "--suite",
    "report",
    "tune",
    "zoo",
}
SAVED = re.compile(r"(?:Save (?:this|it) as|and this as) `([\w.]+)`")


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, and the name of the file to save it as."""

    language: str
    text: str
    file: str | None


def read(page: str) -> str:
    return (CHECKOUT / page).read_text(encoding="utf-8")


def blocks(page: str) -> list[Block]:
    found, before = [], 0
    text = read(page)
    for match in re.finditer(r"^```(\w*)\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE):
        paragraph = text[before : match.start()].rstrip().rpartition("\n\n")[2]
        file = SAVED.search(paragraph.replace("\n", " "))
        found.append(Block(match[1], match[2], file and file[1]))
        before = match.end()
    return found


def commands(page: str) -> list[list[str]]:
    """The words of each command of a page, without comments."""
    shown = [line for block in blocks(page) if block.language == "sh" for line in block.text.splitlines()]
    return [words for line in shown if (words := shlex.split(line, comments=True))]


def run(command: list[str], number: int) -> None:
    """Run a shortened command of tb2rl in this process."""
    name, arguments = command[2].removeprefix("tb2rl."), command[3:]
    if ONLY_PARSED & {name, *arguments}:
        return
    more = RESUMED if "--resume" in arguments else SHORTER.get(name, "")
    if name == "demo" or (name == "play" and not {"--bag", "--video"} & set(arguments)):
        open_page([*command[1:], *more.split()])
        return
    if name == "train" and not {"--name", "--resume"} & set(arguments):
        more += f" --name number-{number}"
    import_module(COMMANDS[name]).main([*arguments, *more.split()])


def open_page(arguments: list[str]) -> None:
    """Run a command that opens a page, in a process, and end it as a user does."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen([sys.executable, *arguments], text=True, **pipes) as process:
        printed = []
        for line in process.stdout:
            printed.append(line)
            if line.startswith("open http://"):
                process.send_signal(signal.SIGINT)
    assert process.returncode == 0, "".join(printed)


def save_files(page: str, folder: Path) -> None:
    for block in blocks(page):
        if block.file:
            (folder / block.file).write_text(block.text, encoding="utf-8")


def test_the_training_of_the_readme_runs_and_its_policy_drives(module_folder):
    train = next(words for words in commands("README.md") if words[:3] == ["python", "-m", "tb2rl.train"])
    run(train, 0)
    run(["python", "-m", "tb2rl.play", "runs/maze/qlearn/first", "--video", "film.gif"], 1)
    assert (module_folder / "film.gif").is_file()


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)])
def test_every_command_of_a_page_parses(page, module_folder):
    save_files(page, module_folder)
    for command in commands(page):
        if command[:2] == ["python", "-m"]:
            import_module(COMMANDS[command[2].removeprefix("tb2rl.")]).main.parse(command[3:])
        elif command[0] == "python":  # a file of the page, tried by a test of its own
            assert (module_folder / command[1]).is_file()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::tb2rl.core.errors.WorldWarning")
@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)])
def test_every_command_of_a_page_runs(page, module_folder):
    save_files(page, module_folder)
    for number, command in enumerate(commands(page)):
        if command[:2] == ["python", "-m"]:
            run(command, number)


@pytest.mark.parametrize("page", [page for page in PAGES if "course" not in page])  # tests/test_course.py runs those
def test_every_python_example_of_a_page_runs(page, module_folder):
    save_files(page, module_folder)
    for block in blocks(page):
        if block.language == "python" and not block.file:
            exec(compile(block.text, page, "exec"), {})


@pytest.mark.parametrize("page", [page for page in PAGES if "```console" in read(page)])
def test_errors_are_as_the_page_quotes_them(page, module_folder, capsys):
    save_files(page, module_folder)
    for block in blocks(page):
        if block.language == "console":
            for shown in re.findall(r"^\$ (.*)\n(.*)$", block.text, flags=re.MULTILINE):
                command, expected = shlex.split(shown[0]), shown[1]
                with pytest.raises(SystemExit):
                    import_module(command[2]).main(command[3:])
                assert capsys.readouterr().err.strip().splitlines()[-1].replace(f"{module_folder}/", "") == expected


def anchors(page: Path) -> list[str]:
    """What links to the headings of a page are called."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return [re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings]


@pytest.mark.parametrize("page", [*PAGES, "CHANGELOG.md", "configs/SEEDS.md"])
def test_every_link_of_a_page_leads_somewhere(page):
    for link in re.findall(r"\]\((?!http)([^)]+)\)", read(page)):
        path, _, anchor = link.partition("#")
        target = (CHECKOUT / page).parent / path if path else CHECKOUT / page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("problem", ADVICE)
def test_the_advice_of_a_training_names_an_entry_of_the_page_of_symptoms(problem):
    page, _, anchor = ADVICE[problem].rpartition("(")[2].removesuffix(")").partition("#")
    assert anchor in anchors(CHECKOUT / page)


@pytest.mark.slow
def test_the_training_loop_of_the_page_for_ros_learns(module_folder, capsys):
    save_files("FROM_ROS.md", module_folder)
    script = module_folder / "my_training.py"
    short = script.read_text().replace("0.98, 4000", "0.98, 1300").replace("range(5)", "range(1)")
    script.write_text(short.replace('TurtleBot2Maze-v0")  #', 'TurtleBot2Maze-v0", episode_steps=50)  #'))
    runpy.run_path(str(script))
    lines = capsys.readouterr().out.splitlines()
    lengths = [int(found[1]) for line in lines if (found := re.search(r"last 100: (\d+) steps", line))]
    assert len(lengths) == 10
    assert lengths[-1] > 2 * lengths[0]
    assert re.fullmatch(r"drove \d+ m, ended by [a-z ]+", lines[-1])


def test_the_task_of_the_page_does_what_the_built_in_one_does(module_folder):
    import tb2rl

    save_files("docs/how-to/extend.md", module_folder)
    shown = tb2rl.make_env("my_task:MyTurtleBot2Maze", simulation="kinematic")
    built_in = tb2rl.make_env("my-maze", simulation="kinematic")
    assert shown.reset(seed=1)[0].tolist() == built_in.reset(seed=1)[0].tolist()
    for action in (0, 1, 3, 3, 2, 0, 0):
        assert shown.step(action)[1] == built_in.step(action)[1]


def test_the_results_of_the_page_are_those_of_the_zoo():
    built = import_module("tb2rl.zoo.entry").entries()
    assert import_module("tb2rl.zoo.cards").overview(built) in read("docs/explanation/evaluation.md")


def test_the_readme_is_short():
    assert len(read("README.md").split()) <= 900


def test_the_page_of_the_api_has_every_module_with_public_names():
    packages = [CHECKOUT / "tb2rl/__init__.py", *(CHECKOUT / "tb2rl").glob("*/__init__.py")]
    public = [file.parent for file in packages if "\n__all__ = " in file.read_text(encoding="utf-8")]
    modules = [".".join(folder.relative_to(CHECKOUT).parts) for folder in public]
    assert sorted(re.findall(r"automodule:: (\S+)", read("docs/reference/api.md"))) == sorted(modules)


def test_the_page_of_the_installation_has_every_extra_and_the_versions():
    project, text = tomllib.loads(read("pyproject.toml"))["project"], read("docs/how-to/install.md")
    extras = text.partition("## Extras")[2].partition("\n## ")[0]
    assert {*re.findall(r"(?<=[|,] )`(\w+)`", extras)} == {*project["optional-dependencies"]}
    for package, lowest, tested in re.findall(r"^\| `(.+)` \| ([\d.]+) \| ([\d.]+) \|$", text, flags=re.MULTILINE):
        assert any(re.split("[; ,]", wanted)[0] == f"{package}>={lowest}" for wanted in project["dependencies"])
        assert f"\n{package}=={tested}\n" in read("constraints.txt").replace("_", "-")

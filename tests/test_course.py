"""The notebooks of the course, with their exercises as readers find them and then solved by the solutions."""

import re
import warnings
from pathlib import Path

import pytest

COURSE = Path(__file__).parent.parent / "docs/course"
NOTEBOOKS = sorted(path.name for path in COURSE.glob("*.ipynb"))


def solutions() -> dict[str, str]:
    """The solution of each exercise, by "NOTEBOOK.EXERCISE"."""
    text = (COURSE / "solutions.md").read_text(encoding="utf-8")
    return dict(re.findall(r"^### Exercise (\d\.\d)$.*?```python\n(.*?)```", text, flags=re.MULTILINE | re.DOTALL))


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_the_solutions_pass_the_checks_of_the_exercises(name, tmp_path):
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(COURSE / name, as_version=4)
    tags = {tag: cell for cell in notebook.cells for tag in cell.metadata.get("tags", ())}
    numbers = [tag.removeprefix("exercise-") for tag in tags if tag.startswith("exercise-")]
    for number in numbers:
        exercise, check = tags[f"exercise-{number}"], tags[f"check-{number}"]
        exercise.source = "\n".join([exercise.source, check.source, solutions()[f"{name[0]}.{number}"]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of Jupyter's own packages
        from nbclient import NotebookClient

        NotebookClient(notebook, timeout=500, resources={"metadata": {"path": str(tmp_path)}}).execute()
    for number in numbers:
        unsolved, solved = (_printed(tags[f"{cell}-{number}"]) for cell in ("exercise", "check"))
        assert f"Exercise {number}: not solved yet." in unsolved, unsolved
        assert f"Exercise {number}: right." in solved, solved
    assert not any(output.get("name") == "stderr" for cell in notebook.cells for output in cell.get("outputs", ()))


def _printed(cell) -> str:
    return "".join(output.get("text", "") for output in cell.outputs)


def test_every_notebook_is_in_the_course_has_exercises_and_no_outputs():
    index = (COURSE / "index.md").read_text(encoding="utf-8")
    assert re.findall(r"^(\d_\w+)$", index, flags=re.MULTILINE) == [name.removesuffix(".ipynb") for name in NOTEBOOKS]
    for name in NOTEBOOKS:
        text = (COURSE / name).read_text(encoding="utf-8")
        exercises = set(re.findall(r'"exercise-(\d)"', text))
        assert {number for number in solutions() if number[0] == name[0]} == {f"{name[0]}.{each}" for each in exercises}
        assert len(exercises) >= 3
        assert '"outputs": [],' in text
        assert '"output_type"' not in text

"""The commands of the zoo build entries from recipes, and find cards that do not hold."""

import json
from functools import partial

import pytest

from tb2rl.commands import train as training
from tb2rl.evaluation.evaluate import evaluate
from tb2rl.execution.local import LocalExecutor

SMALL = "--agent qlearn --simulation kinematic --total-timesteps 2560 --set train.eval_episodes=2 train.eval_steps=20"


@pytest.mark.slow
def test_a_recipe_becomes_an_entry_that_holds_until_its_figures_are_touched(main, own_zoo, capsys):
    def problems() -> str:
        with pytest.raises(SystemExit, match="1"):
            main(["check", "--episodes", "10"])
        return capsys.readouterr().out

    (own_zoo / "recipes.yaml").write_text(f"mine: {SMALL}\n")
    main(["build", "--episodes", "10"])
    card = (own_zoo / "mine" / "README.md").read_text()
    assert SMALL in card
    assert "Falls short" in card
    assert "[mine](mine/README.md)" in (own_zoo / "README.md").read_text()
    before = (own_zoo / "mine" / "best" / "policy.safetensors").stat().st_mtime_ns
    main(["build", "--episodes", "10"])
    assert (own_zoo / "mine" / "best" / "policy.safetensors").stat().st_mtime_ns == before, "what is there stays"
    assert (own_zoo / "mine" / "README.md").read_text() == card

    main(["check"])
    said = capsys.readouterr().out
    assert "mine: 0 % good episodes, " in said
    assert said.endswith("1 cards pass\n")
    figures = own_zoo / "mine" / "evaluation.json"
    tree = json.loads(figures.read_text())
    for each in tree["each"]:
        each.update(ended="time limit", failed=False, distance=2 * each["distance"])
    figures.write_text(json.dumps(tree))
    (own_zoo / "README.md").write_text("all is well")
    said = problems()
    assert "mine: 0 % good episodes in PyBullet, but its earlier evaluation implies at least 72.2 %" in said
    assert "in the same episodes before" in said
    assert "README.md does not match the results" in said

    (own_zoo / "recipes.yaml").write_text(f"mine: {SMALL} agent.gamma=0.5\n")
    said = problems()
    assert "mine: it was not trained by its present recipe" in said
    assert "mine: its card differs from its files" in said
    main(["build", "--episodes", "10"])
    main(["check", "--episodes", "1"])
    assert "agent.gamma=0.5" in (own_zoo / "mine" / "README.md").read_text()
    assert sorted(file.name for file in own_zoo.iterdir()) == ["README.md", "mine", "recipes.yaml"]

    figures.write_text("<<<<<<< HEAD")
    with pytest.raises(SystemExit, match="2"):
        main(["check", "--episodes", "1"])
    assert "evaluation.json is not JSON" in capsys.readouterr().err


def test_a_build_that_is_interrupted_keeps_what_was_trained_and_does_not_train_it_again(main, own_zoo, monkeypatch):
    (own_zoo / "recipes.yaml").write_text(f"mine: {SMALL}\nnext: {SMALL} train.seed=1\n")
    monkeypatch.setattr(training, "evaluate", partial(evaluate, episodes=2, steps=20, workers=1))
    trained = []

    def interrupted(_, function, jobs, shared):
        trained.append(jobs[0].name)
        yield jobs[0], function(*shared, *jobs[0].arguments, jobs[0].folder)
        raise KeyboardInterrupt

    monkeypatch.setattr(LocalExecutor, "as_completed", interrupted)
    for installed in (["mine", "recipes.yaml"], ["mine", "next", "recipes.yaml"]):
        with pytest.raises(SystemExit, match="130"):
            main(["build"])
        assert sorted(file.name for file in own_zoo.iterdir()) == installed
        assert (own_zoo / installed[-2] / "best" / "policy.safetensors").is_file()
    assert trained == ["mine", "next"]


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("build nothing", ["unknown zoo policy 'nothing'", "maze-loop-dqn"]),
        ("check --episodes 0", ["--episodes", "1 to 100"]),
        ("build --barn missing.npz", ["missing.npz"]),
        ("feed", ["feed", "build", "check"]),
    ],
)
def test_arguments_that_do_not_fit_are_refused_in_one_line_before_anything_is_done(line, named, main, refused):
    refused(main, line, named)

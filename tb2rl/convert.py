"""Convert policies to and from Stable-Baselines3's zip files.

    python -m tb2rl.convert runs/maze/dqn/NAME policy.zip
    python -m tb2rl.convert --trust policy.zip runs/maze/dqn/theirs --agent dqn

A zip of Stable-Baselines3 contains pickles, so loading one may execute arbitrary code. Therefore it needs `--trust`. No
other command loads such files.
"""

from pathlib import Path

from tb2rl.core.command import ArgumentParser, command


@command("convert")
def main(parser: ArgumentParser) -> None:
    """Convert a policy to a zip, or with `--trust` a zip to a run."""
    add = parser.add_argument
    add("source", help="run folder, checkpoint in it, zoo:NAME, hf:USER/REPOSITORY; with --trust a zip")
    add("target", type=Path, help="the zip to write; with --trust the run folder to create")
    add("--trust", action="store_true", help="load a zip, which executes its code; for hf:..., see `play --help`")
    add("--agent", help="with --trust: the agent whose algorithm wrote the zip")
    add("--task", help="with --trust: the task of its training (default: maze)")
    add("--set", nargs="+", default=[], action="extend", metavar="KEY=VALUE", help="with --trust: change the task")


if __name__ == "__main__":
    main()

"""Build, check and share the trained policies of the zoo.

    python -m tb2rl.zoo build                          # trains missing and outdated policies, writes all pages
    python -m tb2rl.zoo build maze-loop-dqn --again    # trains an existing policy again
    python -m tb2rl.zoo build --barn PATH              # also evaluates in BARN's worlds
    python -m tb2rl.zoo build --on ray                 # trains and evaluates with Ray, here or on a cluster
    python -m tb2rl.zoo check [NAME ...]
    python -m tb2rl.zoo push NAME user/repository      # uploads a policy or a run folder to the Hugging Face hub

`recipes.yaml` has the arguments of `python -m tb2rl.train` for each policy. Trainings write to `runs`. The zoo copies
the policies and evaluations from there, and adds a card (README.md), a picture of paths, and evaluations in unseen
worlds (unseen_worlds.json).

Policies for task `navigate` are evaluated in suites instead of unseen worlds. `suites.yaml` lists further policies for
suites, mostly agents that do not learn. The folder `suites` has the results.

`check` repeats the standard evaluations, compares the results with the earlier ones, and finds outdated files.

`push` uploads safetensors, JSON, a picture and a card. Every command then accepts the policy as `hf:user/repository`.
The upload uses the token of `hf auth login` or of HF_TOKEN.
"""

from pathlib import Path

from tb2rl.core.command import ArgumentParser, command
from tb2rl.execution.arguments import add_executor_arguments


@command("zoo")
def main(parser: ArgumentParser) -> None:
    """Build, check or push policies; exit with status 1 if a check finds problems."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="build | check | push")
    build = commands.add_parser("build", help="train and evaluate what is missing or outdated, and write all pages")
    build.add_argument("--again", action="store_true", help="train and evaluate existing policies again")
    build.add_argument("--barn", type=Path, metavar="PATH", help="also evaluate in the BARN worlds of this path")
    add_executor_arguments(build)
    check = commands.add_parser("check", help="repeat and compare the standard evaluations, and find outdated files")
    check.add_argument("--episodes", type=int, help="number of episodes to repeat (default: all)")
    for sub in (build, check):
        sub.add_argument("names", nargs="*", metavar="NAME", help="names in recipes.yaml or suites.yaml (default: all)")
    push = commands.add_parser("push", help="upload a policy to the Hugging Face hub")
    push.add_argument("name", metavar="NAME", help="a policy of the zoo, or a run folder")
    push.add_argument("repository", metavar="user/repository", help="created if it does not exist")
    push.add_argument("--private", action="store_true", help="make a new repository private")
    for sub, run in ((build, "maintenance:build"), (check, "maintenance:check"), (push, "sharing:push")):
        sub.set_defaults(run=f"tb2rl.zoo.{run}")


if __name__ == "__main__":
    main()

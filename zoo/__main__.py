"""List, show, build, check and share the trained policies of the zoo.

    python -m tb2rl.zoo list --task navigate           # what there is, with results
    python -m tb2rl.zoo show maze-loop-dqn             # the card of a policy
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

All policies are compared in all physics simulators that are installed: in the same 1 000 episodes, and in suites in the
same worlds. `build` makes what is missing and keeps what is valid, so an interrupted build goes on.

`check` repeats the standard evaluations in all physics simulators, compares the results with the earlier ones, and
finds outdated files.

`push` uploads safetensors, JSON, a picture and a card. Every command then accepts the policy as `hf:user/repository`.
The upload uses the token of `hf auth login` or of HF_TOKEN.
"""

from pathlib import Path

from tb2rl.core.command import ArgumentParser, between, command
from tb2rl.core.plugins import simulator_names
from tb2rl.execution.arguments import add_executor_arguments


@command("zoo")
def main(parser: ArgumentParser) -> None:
    """List, show, build, check or push policies; exit with status 1 if a check finds problems."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="list | show | build | check | push")
    listing = commands.add_parser("list", help="list the policies with their results")
    for option, help_text in (
        ("task", "only policies for this task"),
        ("robot", "only policies for this robot"),
        ("simulation", "only policies with results in this physics simulator"),
    ):
        listing.add_argument(f"--{option}", metavar="NAME", help=help_text)
    show = commands.add_parser("show", help="show the card of a policy")
    show.add_argument("name", metavar="NAME", help="a policy of the zoo")
    build = commands.add_parser("build", help="train and evaluate what is missing or outdated, and write all pages")
    build.add_argument("--again", action="store_true", help="train and evaluate existing policies again")
    build.add_argument("--barn", type=Path, metavar="PATH", help="also evaluate in the BARN worlds of this path")
    help_text = "episodes of each policy in each physics simulator, for their comparison (default: 1000)"
    build.add_argument("--episodes", type=between(1, 100_000), default=1000, help=help_text)
    add_executor_arguments(build)
    check = commands.add_parser("check", help="repeat and compare the standard evaluations, and find outdated files")
    check.add_argument("--episodes", type=int, help="number of episodes to repeat (default: all)")
    help_text = f"{', '.join(simulator_names())} or module:Class (default: all physics simulators with results)"
    check.add_argument("--simulation", metavar="NAME", help=help_text)
    for sub in (build, check):
        sub.add_argument("names", nargs="*", metavar="NAME", help="names in recipes.yaml or suites.yaml (default: all)")
    push = commands.add_parser("push", help="upload a policy to the Hugging Face hub")
    push.add_argument("name", metavar="NAME", help="a policy of the zoo, or a run folder")
    push.add_argument("repository", metavar="user/repository", help="created if it does not exist")
    push.add_argument("--private", action="store_true", help="make a new repository private")
    for sub, run in (
        (listing, "listing:list_policies"),
        (show, "listing:show_policy"),
        (build, "maintenance:build"),
        (check, "maintenance:check"),
        (push, "sharing:push"),
    ):
        sub.set_defaults(run=f"tb2rl.zoo.{run}")


if __name__ == "__main__":
    main()

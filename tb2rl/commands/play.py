"""Implementation of `python -m tb2rl.play`: a live drive, or what `commands/film.py` writes."""

import argparse
from contextlib import suppress

from tb2rl.commands.arguments import refuse
from tb2rl.core import exit_by_signal, handle_termination_signals
from tb2rl.core.compiled import announce_compiling


def run(arguments: argparse.Namespace) -> None:
    """Drive on a page until the user ends the program, or write films or bags."""
    announce_compiling()
    if arguments.teleop:
        refuse(arguments, "cannot be combined with --teleop", "agent", "policy", "video", "bag")
        arguments.agent = "random"  # its task decides the rewards, and the user drives
    with handle_termination_signals(exit_by_signal):  # exit by an exception, which removes a half-written file
        if arguments.video or arguments.bag:
            from tb2rl.commands import film

            refuse(arguments, "cannot be combined with --video or --bag", "viewer", "host", "port")
            film.run(arguments)
        else:
            refuse(arguments, "needs --video or --bag", "episodes")
            _drive(arguments)


def _drive(arguments: argparse.Namespace) -> None:
    """Open a page, and drive until the user ends the program."""
    from tb2rl.viz.viewer.server import open_server  # imported here, because films and bags need no page

    with suppress(KeyboardInterrupt), open_server(arguments.host, arguments.port) as server:
        # Imported after the page is announced, because the browser starts meanwhile.
        from tb2rl.commands.film import chosen_drive, chosen_options
        from tb2rl.viz.viewer.drive import Selection
        from tb2rl.viz.viewer.page import drive_live

        options = chosen_options(arguments)
        policy, config = chosen_drive(arguments, options)
        if arguments.steps is not None:
            config = config.with_task({"episode_steps": arguments.steps})
        selection = Selection(policy, config, options.simulator, arguments.policy or arguments.agent)
        view = {"speed": options.speed, "follow": options.camera == "chase", "is_manual": arguments.teleop}
        drive_live(server, selection, options.seed, **view)

"""Live drives on a page, until the user ends the program."""

import os
import sys
import webbrowser
from contextlib import ExitStack, closing, suppress

from tb2rl.evaluation.progress import say
from tb2rl.viz.viewer.drive import Drive, Selection
from tb2rl.viz.viewer.page import Page, TourStop
from tb2rl.viz.viewer.server import ViewerServer


def drive_live(
    selection: Selection,
    seed: int = 0,
    speed: float = 1.0,
    follow: bool = False,
    is_manual: bool = False,
    host: str | None = None,
    port: int | None = None,
    tour: tuple[TourStop, ...] = (),
) -> None:
    """Open a page, and drive until Ctrl-C.

    Args:
        selection: The policy, the task and the simulator.
        seed: Seed of the first episode; each further episode adds 1.
        speed: Simulated seconds per second.
        follow: Whether the camera follows the robot.
        is_manual: Whether the user drives at the start.
        host, port: See `ViewerServer`.
        tour: Stops of a tour; empty: no tour.

    Raises:
        InputError: If the policy does not fit the task, or the page cannot be opened.
    """
    with suppress(KeyboardInterrupt), ExitStack() as stack:
        server = ViewerServer(host, port)
        stack.callback(server.stop)
        drive = stack.enter_context(closing(Drive(selection, seed)))
        drive.speed = speed
        if is_manual:
            drive.drive_manually(True)
        page = Page(server, drive, follow, tour)
        announce(server)  # before the first frame, because the browser starts while this process makes the 3D models
        drive.run(page.show, page.report, lambda: True)


def announce(server: ViewerServer) -> None:
    """Say where the page is, and open it in the browser if there is a display."""
    say(f"open {server.url} in a browser; Ctrl-C ends")
    if server.warning:
        print(f"warning: {server.warning}", file=sys.stderr, flush=True)
    if sys.stdout.isatty() and (not sys.platform.startswith("linux") or os.environ.get("DISPLAY")):
        webbrowser.open(server.url)

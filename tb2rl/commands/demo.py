"""Implementation of `python -m tb2rl.demo`: a tour of the zoo in the viewer."""

import argparse
from contextlib import suppress

from tb2rl.core.compiled import announce_compiling
from tb2rl.viz.viewer.server import open_server

_ROOMS = "generated: rooms"
TOUR = (  # arguments of each `TourStop`
    (
        "A table",
        "Q-learning learned this table in seconds. The robot sees nine distances, each in one of four classes, and "
        "chooses the action with the largest value in the row of what it sees: watch the bars of the values.",
        "zoo:maze-loop-qlearn",
    ),
    (
        "A network",
        "SAC learned a network that maps the laser's ranges to a speed and a turn rate, so the robot drives smoothly.",
        "zoo:drive-loop-sac",
    ),
    (
        "Anywhere",
        "This policy was trained in 512 generated worlds. It has never seen this one: choose other worlds, "
        "make them more difficult, let people walk in them.",
        "zoo:anywhere-ppo",
        _ROOMS,
    ),
    (
        "To a goal",
        "Drag the green disc, or click on the floor, and the robot drives there along the green line. Let a click "
        "*add a wall*, and put one in its way with two clicks: it takes another way.",
        "zoo:navigate-plan-ppo",
        _ROOMS,
    ),
)


def run(arguments: argparse.Namespace) -> None:
    """Open the page of the tour, until Ctrl-C."""
    announce_compiling()
    with suppress(KeyboardInterrupt), open_server(arguments.host, arguments.port) as server:
        # Imported after the page is announced, because the browser starts meanwhile.
        from tb2rl.simulation.simulator import default_simulator
        from tb2rl.viz.viewer.choices import make_selection
        from tb2rl.viz.viewer.page import TourStop, drive_live

        tour = [TourStop(*stop) for stop in TOUR]
        selection = make_selection(tour[0].policy, "maze", {}, arguments.simulation or default_simulator())
        drive_live(server, selection, tour=tour)

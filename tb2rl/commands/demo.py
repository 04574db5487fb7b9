"""Implementation of `python -m tb2rl.demo`: a tour of the zoo in the viewer."""

import argparse

from tb2rl.core.compiled import announce_compiling
from tb2rl.simulation.simulator import default_simulator
from tb2rl.viz.viewer.choices import make_selection
from tb2rl.viz.viewer.page import TourStop, drive_live

_ROOMS = "generated: rooms"
TOUR = (
    TourStop(
        "A table",
        "Q-learning learned this table in seconds. The robot sees nine distances, each in one of three classes, and "
        "chooses the action with the largest value in the row of what it sees: watch the bars of the values.",
        "zoo:maze-loop-qlearn",
    ),
    TourStop(
        "A network",
        "SAC learned a network that maps the laser's ranges to a speed and a turn rate, so the robot drives smoothly.",
        "zoo:drive-loop-sac",
    ),
    TourStop(
        "Anywhere",
        "This policy was trained in 512 generated worlds. It has never seen this one: choose other worlds, "
        "make them more difficult, let people walk in them.",
        "zoo:anywhere-ppo",
        _ROOMS,
    ),
    TourStop(
        "To a goal",
        "Drag the green disc, or click on the floor, and the robot drives there along the green line. Choose "
        "*add a wall*, and put one in its way with two clicks: it takes another way.",
        "zoo:navigate-plan-ppo",
        _ROOMS,
    ),
)


def run(arguments: argparse.Namespace) -> None:
    """Open the page of the tour, until Ctrl-C."""
    announce_compiling()
    selection = make_selection(TOUR[0].policy, "maze", {}, arguments.simulation or default_simulator())
    drive_live(selection, host=arguments.host, port=arguments.port, tour=TOUR)

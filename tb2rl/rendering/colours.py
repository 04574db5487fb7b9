"""Colours of pictures from above and of charts."""

FLOOR, WALL, PATH, BEAM = "#f4f1ea", "#a85c45", "#2f6fb0", "#f0a63c"
BODY, WHEEL, NOSE = "#2b2d31", "#77797d", "#6cc04a"
GOAL, FAILED, START = "#6cc04a", "#d62728", "#2ca02c"
DYNAMIC_OBSTACLE, ROUTE = "#7d4fa0", "#dccbe8"
FREE = "#d9e8d2"  # space that the robot can reach
STRIP, LABEL = "#ffffff", "#77797d"  # background and labels of a caption
FILM_PALETTE = (FLOOR, WALL, PATH, BEAM, BODY, WHEEL, NOSE, FAILED, STRIP, DYNAMIC_OBSTACLE)

"""The colours of pictures from above, and of the charts that go with them."""

FLOOR, WALL, PATH, BEAM = "#f4f1ea", "#a85c45", "#2f6fb0", "#f0a63c"
BODY, WHEEL, NOSE = "#2b2d31", "#77797d", "#6cc04a"
GOAL, FAILED, START = "#6cc04a", "#d62728", "#2ca02c"
MOVER, ROUTE = "#7d4fa0", "#dccbe8"  # what moves, and the paths that it follows
FREE = "#d9e8d2"  # what a robot can get to
STRIP, LABEL = "#ffffff", "#77797d"  # of a caption
DRAWN = (FLOOR, WALL, PATH, BEAM, BODY, WHEEL, NOSE, FAILED, STRIP, MOVER)  # what a film's palette is made from

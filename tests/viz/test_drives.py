"""Drives from bags on a page: their metrics, their paths in a world, and the names of their topics."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.deploy.bags.reading import Drive
from tb2rl.viz.drives import drive_section
from tb2rl.viz.page import page
from tb2rl.worlds import World
from tb2rl.worlds.registry import find_world

STEPS = 50


@pytest.fixture
def drive() -> Drive:
    """A drive along x by odometry, with two contacts, towards a wall."""
    times, zeros = np.arange(STEPS) * 0.2, np.zeros(STEPS)
    return Drive(
        name="<b>drive</b>",
        topics={"odom": "/<i>odom</i>"},
        odometry=np.column_stack([times, times * 0.5, zeros, zeros, zeros + 0.5, zeros]),
        truth=np.empty((0, 6)),
        commands=np.column_stack([times, zeros + 0.5, zeros]),
        scan_minima=np.column_stack([times, 6.0 - times * 0.5]),
        bumper=np.array([(0.0, 0.0), (1.0, 1.0), (2.0, 1.0), (3.0, 0.0), (4.0, 1.0)]),
        goals=np.empty((0, 3)),
    )


def shown(pages, drive: Drive, world: World | None = None):
    return pages(page([], drives=[drive_section(drive, world)]))


def marks(found, kind: str) -> int:
    """Number of marks of a kind in the picture."""
    inside = re.search(rf'<g id="[^"]*-{kind}">(.*?)</g>\s*</g>', found.source, flags=re.DOTALL)
    return len(re.findall("<use ", inside[1])) if inside else 0


def test_the_table_has_the_metrics_of_the_drive_and_names_are_text(drive, pages):
    found = shown(pages, drive)
    assert "9.8 4.9 0.500 1.10 2" in found.text
    assert "in the odometry's frame" in found.text
    assert [marks(found, kind) for kind in ("start", "contacts", "goal")] == [1, 2, 0]
    assert [name for name in ("<b>drive</b>", "/<i>odom</i>") if name not in found.text] == []
    assert found.count("b") == found.count("i") == 0


def test_topics_that_were_not_recorded_are_left_out(drive, pages):
    nothing = np.empty((0, 3))
    found = shown(pages, replace(drive, commands=nothing, scan_minima=nothing[:, :2], bumper=nothing[:, :2]))
    assert "9.8 4.9 0.500 \u2013 \u2013" in found.text
    assert [word for word in ("commanded", "shortest range", "contact ") if word in found.text] == []


def test_odometry_begins_at_the_worlds_start_and_a_true_path_where_it_was(drive, pages):
    world = find_world("wall")
    assert "by odometry, from the start of wall" in shown(pages, drive, world).text
    found = shown(pages, replace(drive, truth=drive.odometry, goals=np.array([(0.0, 1.0, 2.0)])), world)
    assert "True path in wall" in found.text
    assert marks(found, "goal") == 1
    far = replace(drive, truth=drive.odometry + [0.0, 100.0, 0.0, 0.0, 0.0, 0.0])
    assert ">100<" in drive_section(far, world).path, "a drive that leaves the world is shown whole"


@pytest.mark.parametrize("rows", [1, 100_000])
def test_a_drive_may_be_short_or_long(rows, drive):
    times = np.arange(rows) * 0.02
    odometry = np.column_stack([times, np.cos(times), np.sin(times), times, times * 0.0 + 1.0, times * 0.0])
    nearest = np.column_stack([times, np.where(np.arange(rows) == rows // 2, 0.1, 5.0)])
    section = drive_section(replace(drive, odometry=odometry, scan_minima=nearest, commands=odometry[:, :3]))
    assert sum(map(len, (section.path, section.speed, section.turn_rate, section.nearest))) < 200_000

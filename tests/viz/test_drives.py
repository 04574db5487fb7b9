"""What a report says of a drive: its figures, its path in the world, and what happened when."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from tb2rl.deploy.bags.drive import Drive
from tb2rl.viz.drives import drive_section
from tb2rl.viz.page import page
from tb2rl.worlds import World
from tb2rl.worlds.registry import find_world

STEPS = 50


@pytest.fixture
def drive() -> Drive:
    """A drive along x by odometry, that touches something twice, nearer and nearer to a wall."""
    times, zeros = np.arange(STEPS) * 0.2, np.zeros(STEPS)
    odometry = np.column_stack([times, times * 0.5, zeros, zeros, zeros + 0.5, zeros])
    return Drive(
        name="<b>drive</b>",
        topics={"odom": "/<i>odom</i>"},
        odometry=odometry,
        truth=np.empty((0, 6)),
        commands=np.column_stack([times, zeros + 0.5, zeros]),
        nearest=np.column_stack([times, 6.0 - times * 0.5]),
        touches=np.array([(0.0, 0.0), (1.0, 1.0), (2.0, 1.0), (3.0, 0.0), (4.0, 1.0)]),
        goals=np.empty((0, 3)),
    )


def shown(pages, drive: Drive, world: World | None = None):
    return pages(page([], drives=[drive_section(drive, world)]))


def marks(found, what: str) -> int:
    """How many marks of a kind stand in the picture."""
    inside = re.search(rf'<g id="[^"]*-{what}">(.*?)</g>\s*</g>', found.source, flags=re.DOTALL)
    return len(re.findall("<use ", inside[1])) if inside else 0


def test_the_table_has_the_figures_of_the_drive(drive, pages):
    found = shown(pages, drive)
    assert "9.8 4.9 0.500 1.10 2" in found.text
    assert "in the odometry's own frame" in found.text
    assert (marks(found, "start"), marks(found, "touches"), marks(found, "goal")) == (1, 2, 0)


def test_what_was_not_recorded_is_not_said(drive, pages):
    nothing = np.empty((0, 3))
    found = shown(pages, replace(drive, commands=nothing, nearest=nothing[:, :2], touches=nothing[:, :2]))
    assert "9.8 4.9 0.500 \u2013 \u2013" in found.text
    assert [word for word in ("commanded", "shortest range", "touch ") if word in found.text] == []


def test_names_from_the_bag_are_text(drive, pages):
    found = shown(pages, drive)
    assert "<b>drive</b>" in found.text
    assert "/<i>odom</i>" in found.text
    assert {"b", "i"} & {tag for tag, _ in found.elements} == set()


def test_odometry_begins_at_the_start_of_the_world_and_the_truth_where_it_was(drive, pages):
    world = find_world("wall")
    assert "by odometry, from the start of wall" in shown(pages, drive, world).text
    found = shown(pages, replace(drive, truth=drive.odometry, goals=np.array([(0.0, 1.0, 2.0)])), world)
    assert "Where it truly was, in wall" in found.text
    assert marks(found, "goal") == 1


def test_a_drive_that_leaves_the_world_is_shown_whole(drive):
    far = replace(drive, truth=drive.odometry + [0.0, 100.0, 0.0, 0.0, 0.0, 0.0])
    assert ">100<" in drive_section(far, find_world("wall")).path


@pytest.mark.parametrize("rows", [1, 2, 100_000])
def test_a_drive_may_be_short_or_long(rows, drive):
    times = np.arange(rows) * 0.02
    odometry = np.column_stack([times, np.cos(times), np.sin(times), times, times * 0.0 + 1.0, times * 0.0])
    nearest = np.column_stack([times, np.where(np.arange(rows) == rows // 2, 0.1, 5.0)])
    section = drive_section(replace(drive, odometry=odometry, nearest=nearest, commands=odometry[:, :3]))
    assert sum(map(len, (section.path, section.speed, section.turn, section.nearest))) < 200_000


def test_a_scan_that_hit_nothing_leaves_a_gap(drive, pages):
    found = shown(pages, replace(drive, nearest=np.array([(0.0, math.inf), (1.0, math.inf)])))
    assert "inf" in found.text

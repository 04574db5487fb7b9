"""Pure pursuit drives along the arc to its target, and bends it if it is not free."""

from __future__ import annotations

import numpy as np
import pytest

from tb2rl.agents.pursuit import Pursuit


@pytest.mark.parametrize("target", [(1.2, 0.5), (1.4, -0.2), (0.6, 0.6)])
def test_its_arc_leads_to_the_target(target, playground):
    v, w = playground(target).command(Pursuit, speeds=(0.5, 0.0))
    assert w / v == pytest.approx(2.0 * target[1] / np.hypot(*target) ** 2, rel=1e-4)


def test_it_is_slow_on_sharp_arcs_and_towards_obstacles(playground):
    straight = playground((1.4, 0.0)).command(Pursuit)[0]
    bent = playground((0.1, 0.4)).command(Pursuit)[0]
    near = playground((1.4, 0.0), [(0.7, 0.0, 0.3)]).command(Pursuit, bends=0)[0]
    assert straight == pytest.approx(0.65)
    assert 0.0 < near < bent < straight


def test_it_turns_on_the_spot_to_a_target_behind(playground):
    for side in (-1.0, 1.0):
        v, w = playground((-1.0, 0.3 * side)).command(Pursuit)
        assert v == pytest.approx(0.0, abs=1e-6)
        assert w * side > 0.5


def test_it_bends_round_a_post_and_without_bends_it_slows_down(playground):
    floor = playground((1.4, 0.0), [(0.6, 0.05, 0.2)])
    straight, bent = (floor.command(Pursuit, speeds=(0.3, 0.0), bends=bends) for bends in (0, 16))
    assert straight[0] < 0.5
    assert straight[1] == pytest.approx(0.0, abs=1e-6)
    assert bent[0] > straight[0]
    assert bent[1] < -0.2

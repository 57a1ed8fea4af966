"""Which candidates the recorder stops early, told from states that no engine had to simulate."""

import numpy as np
import pytest

from neoworld_mjx.physics.engine import EarlyStop, RolloutStatus, Schedule
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.recorder import Recorder
from tests.support import scenes
from tests.support.scenes import compile_scene

STEPS = 5
"""Of a segment; 0.02 s."""


@pytest.fixture(scope="module")
def blocks():
    return compile_scene(scenes.blocks())


def steps_until_stopped(scene, *, away=lambda k: 0.0, speed=lambda k: 0.0, turned=lambda k: 0.0):
    """Return status and steps of one candidate whose first object's state is given by segment.

    Args:
        scene: of blocks.
        away: its distance from where it was placed [m].
        speed: of it [m/s].
        turned: its angle about z [rad].
    """
    start = scene.place_exactly(Layout.zero(1, len(scene.names)))
    static = scene.static
    recorder = Recorder(static, start, Schedule(10, 25, EarlyStop()))
    for k in range(50):
        qpos, rates = static.start[None].copy(), np.zeros((1, static.mjm.nv))
        qpos[0, 0] += away(k)
        half = turned(k) / 2
        w, x, y, z = qpos[0, 3:7]
        c, s = np.cos(half), np.sin(half)
        qpos[0, 3:7] = [c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w]
        rates[0, 0] = speed(k)
        recorder.record(k // 5, qpos, rates, 0.0 * rates, STEPS)
        if not len(recorder.active):
            break
    return RolloutStatus(int(recorder.status[0])), int(recorder.steps[0])


def test_an_object_at_rest_settles_after_a_tenth_of_a_second(blocks):
    assert steps_until_stopped(blocks) == (RolloutStatus.SETTLED, 25)


def test_a_decelerating_object_settles_and_an_accelerating_one_does_not(blocks):
    slower = steps_until_stopped(blocks, speed=lambda k: 0.004 * 0.9**k)
    assert slower == (RolloutStatus.SETTLED, 25)
    # Below the bound for 0.4 s, as something that begins to topple.
    faster = steps_until_stopped(blocks, speed=lambda k: 1e-4 * 1.2**k)
    assert faster == (RolloutStatus.OK, 250)


def test_what_stays_far_off_without_coming_to_rest_settles(blocks):
    quiver = lambda k: 0.02 + 0.01 * (k % 2)
    gone = lambda k: 0.02 if k >= 4 else 0.0
    assert steps_until_stopped(blocks, speed=quiver, away=gone)[0] == RolloutStatus.SETTLED


def test_only_records_beyond_the_bounds_make_a_candidate_invalid(blocks):
    quiver = lambda k: 0.02 + 0.01 * (k % 2)
    back = lambda k: 0.02 if k == 4 else 0.0
    assert steps_until_stopped(blocks, speed=quiver, away=back)[0] == RolloutStatus.SETTLED
    between = lambda k: 0.02 if k == 3 else 0.0
    assert steps_until_stopped(blocks, speed=quiver, away=between)[0] == RolloutStatus.OK

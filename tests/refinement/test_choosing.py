"""Order in which candidates are checked as the winner."""

import jax
import numpy as np
import pytest

from neoworld_mjx.config import RefineOptions
from neoworld_mjx.physics.layout import Layout
from neoworld_mjx.physics.model import compile_scene
from neoworld_mjx.refinement.choosing import choose
from neoworld_mjx.refinement.objective import Scores
from neoworld_mjx.refinement.rounds import Round
from neoworld_mjx.spec import Box
from tests.support import scenes

OPTIONS = RefineOptions(finalists=3, check_duration_s=0.5)
FALLS, STANDS = 0.06, 0.03
"""Offsets of the plate's center from that of its support [m], whose edge is at 0.05."""


def searched(plate_x, valid):
    """A plate on a block, and an iteration with the plate at each of `plate_x`, best first."""
    low = scenes.single("low", (Box(size=(0.1, 0.1, 0.06)), (0, 0, 0)))
    plate = scenes.single("plate", (Box(size=(0.1, 0.06, 0.02)), (0, 0, 0)))
    on_low = {"parent": "low", "z": 0.06}
    model = compile_scene(
        scenes.on_table((low, (0, 0), 0.0, {}), (plate, (0.0, 0.0), 0.0, on_low), name="plate")
    )
    pop, count = len(plate_x), len(model.names)
    xy = np.zeros((pop, count, 2), np.float32)
    xy[:, model.names.index("plate"), 0] = plate_x
    layouts = Layout(xy, np.zeros((pop, count), np.float32), np.zeros((pop, count), np.float32))
    poses = jax.tree.map(np.asarray, model.place(layouts))
    better = -np.arange(pop, dtype=np.float32)
    still = np.zeros((pop, count), np.float32)
    scores = Scores(
        {}, np.array(valid), np.zeros(pop, np.int32), better, better, better, still, still, None
    )
    return model, [Round(layouts, poses, scores, np.zeros(pop, bool))]


NEAR = [FALLS + 1e-4 * k for k in range(6)]


def test_positions_that_failed_the_check_are_skipped():
    chosen = choose(*searched([*NEAR, STANDS], [True] * 7), OPTIONS)
    assert chosen.passed and chosen.index == (0, 6) and chosen.tried == 2


@pytest.mark.parametrize(
    ("plate_x", "valid"),
    [([*NEAR, STANDS], [True] * 6 + [False]), (NEAR, [True] * 6)],
    ids=["not valid", "nowhere else"],
)
def test_otherwise_candidates_are_checked_in_order_of_fidelity(plate_x, valid):
    start = searched(plate_x, valid)[1][0].layouts[:1]
    chosen = choose(*searched(plate_x, valid), OPTIONS, start)
    assert not chosen.passed and chosen.index[1] in (0, 1, 2, -1)
    assert chosen.tried == OPTIONS.finalists


def test_the_best_passing_candidate_wins():
    chosen = choose(*searched([STANDS, 0.0], [True, True]), OPTIONS)
    assert chosen.passed and chosen.index == (0, 0) and chosen.tried == 1

"""The final alignment of objects that the refinement moved in the image."""

import numpy as np
import pytest

from neoworld_mjx.config import AlignOptions, RefineOptions, SettleOptions
from neoworld_mjx.estimate.result import Alignment
from neoworld_mjx.measure import passes
from neoworld_mjx.search import final_alignment
from neoworld_mjx.search.final_alignment import FinalAlignment, align_final
from neoworld_mjx.spec import world_poses
from neoworld_mjx.spec.scene import PoseUncertainty
from tests.estimate import desk
from tests.support.scenes import changed

MOVED = {"box": (8.0, -6.0, 4.0, 2.0), "can": (-6.0, 6.0, 0.0, 0.0)}
"""Displacements of a correct composed scene by the refinement: dx, dy [mm], yaw [deg], size [%]."""
KNOWN = PoseUncertainty(along=0.01, across=0.004, yaw=0.02, log_scale=0.01)


@pytest.fixture(scope="module")
def five():
    scene = desk.five()
    objects = [item.model_copy(update={"uncertainty": KNOWN}) for item in scene.objects]
    return scene.model_copy(update={"objects": tuple(objects)})


@pytest.fixture(scope="module")
def photo(five):
    return desk.photograph(five, 640)


@pytest.fixture(scope="module")
def refined(five):
    return desk.displaced(five, **MOVED)


@pytest.fixture(scope="module")
def final(five, refined, photo):
    return align_final(five, refined, photo)


def test_moved_objects_return_to_their_place_in_the_photograph(final, refined, five):
    assert final.aligned == ("box", "can")
    before, after = desk.distances(refined, five), desk.distances(final.scene, five)
    assert max(after[name] for name in MOVED) < 2.5 < 8 < min(before[name] for name in MOVED)
    assert desk.turns(final.scene, five)["box"] < 1 < desk.turns(refined, five)["box"]


def test_the_other_objects_and_the_camera_keep_their_poses(final, refined):
    assert final.scene.camera == refined.camera
    after, before = world_poses(final.scene), world_poses(refined)
    for name in ("brick", "tower", "ball"):
        assert np.linalg.norm(after[name].pos - before[name].pos) < 5e-4, name


def test_the_result_passes_the_final_check_and_keeps_the_uncertainty(final):
    assert passes(final.measure, RefineOptions())
    assert all(item.uncertainty == KNOWN for item in final.scene.objects)


def test_objects_to_keep_are_not_aligned(five, refined, photo):
    found = align_final(five, refined, photo, keep=("can",))
    assert found.aligned == ("box",)
    can = world_poses(found.scene)["can"].pos - world_poses(refined)["can"].pos
    assert np.linalg.norm(can) < 5e-4
    assert align_final(five, refined, photo, keep=MOVED) == FinalAlignment(refined)


@pytest.mark.parametrize("case", ["no camera", "no settling", "no contours", "black"])
def test_without_evidence_or_settling_the_refined_scene_stays(case, five, refined, photo):
    options, align = RefineOptions(), AlignOptions()
    if case == "no camera":
        refined = refined.model_copy(update={"camera": None})
    elif case == "no settling":
        options = RefineOptions(settle=SettleOptions(enabled=False))
    elif case == "no contours":
        align = AlignOptions(contours=False)
    else:
        photo = np.zeros_like(photo)
    assert align_final(five, refined, photo, options, align) == FinalAlignment(refined)


def returning(monkeypatch, aligned, right):
    """Make the alignment return a scene, with the changes of a right alignment."""
    fake = Alignment(aligned, objects=right.objects)
    monkeypatch.setattr(final_alignment, "align_again", lambda *args, **more: fake)


@pytest.fixture(scope="module")
def right(refined, photo):
    return final_alignment.align_again(refined, photo, MOVED)


def test_an_object_that_agrees_less_with_the_photograph_keeps_its_pose(
    monkeypatch, five, refined, photo, right
):
    worse = desk.displaced(right.scene, can=(-30.0, 20.0, 0.0, 0.0))
    returning(monkeypatch, worse, right)
    found = align_final(five, refined, photo)
    assert found.aligned == ("box",)
    can = world_poses(found.scene)["can"].pos - world_poses(refined)["can"].pos
    assert np.linalg.norm(can) < 5e-4


def test_an_object_that_does_not_rest_keeps_its_pose(monkeypatch, five, refined, photo, right):
    falls = changed(right.scene, "can", base_tilt=(np.cos(0.3), np.sin(0.3), 0.0, 0.0))
    returning(monkeypatch, falls, right)
    found = align_final(five, refined, photo)
    assert found.aligned == ("box",)


def test_an_object_keeps_its_pose_if_what_it_carries_would_fall(monkeypatch):
    board = (desk.block("board", 0.16, 0.16, 0.02, "red"), (-0.05, 0.0), 0.0, {})
    on_board = {"parent": "board", "relation": "on", "z": 0.02}
    cube = (desk.block("cube", 0.05, 0.05, 0.05, "blue"), (0.05, 0.05), 0.0, on_board)
    brick = (desk.block("brick", 0.1, 0.06, 0.06, "green"), (-0.05, 0.25), 0.0, {})
    start = desk.on_desk(board, cube, brick)
    photo = desk.photograph(start, 640)
    refined = desk.displaced(start, board=(6, 0, 0, 0), cube=(-4, 4, 0, 0), brick=(6, 0, 0, 0))
    right = final_alignment.align_again(refined, photo, ("board", "cube", "brick"))
    small = desk.displaced(right.scene, board=(0, 0, 0, -45))
    objects = [
        small.object(item.name) if item.name == "board" else item for item in right.scene.objects
    ]
    returning(monkeypatch, right.scene.model_copy(update={"objects": tuple(objects)}), right)
    # The cube falls off a smaller board, whether or not it is itself aligned again.
    for keep in ((), ("cube",)):
        found = align_final(start, refined, photo, keep=keep)
        assert "brick" in found.aligned and "board" not in found.aligned
        assert world_poses(found.scene)["cube"].pos[2] > 0.015


def test_a_scene_that_fails_its_check_is_not_used(five, refined, photo):
    strict = RefineOptions(max_drift_m=1e-9)
    assert align_final(five, refined, photo, strict) == FinalAlignment(refined)
    # The check decides, not the options of the alignment.
    assert align_final(five, refined, photo, RefineOptions()).aligned

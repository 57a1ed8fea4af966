"""Masks: formats, names, and the objects that masks without names belong to."""

import json

import numpy as np
import pytest
from PIL import Image

from neoworld_mjx.errors import EvidenceError
from neoworld_mjx.evidence.mask_files import matched_to, read_masks
from neoworld_mjx.evidence.masks import Masks
from neoworld_mjx.spec import Box2D, Box3D, Camera, SceneTree, TreeNode
from tests.support.made_up_view import BOXES, HEIGHT, WIDTH, labels


@pytest.mark.parametrize("names", [{"red": 3, "blue": 5}, {"3": "red", "5": "blue", "0": "bg"}])
def test_numbers_with_names(tmp_path, names):
    Image.fromarray(labels()).save(tmp_path / "masks.png")
    (tmp_path / "masks.json").write_text(json.dumps(names))
    masks = read_masks(tmp_path / "masks.png")
    assert masks.names == {"red": 3, "blue": 5}
    left, top, right, bottom = BOXES["red"]
    assert masks.of("red").sum() == (right - left) * (bottom - top)


def test_one_image_for_each_object(tmp_path):
    for name, (left, top, right, bottom) in BOXES.items():
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[top:bottom, left:right] = 255
        Image.fromarray(mask).save(tmp_path / f"{name}.png")
    masks = read_masks(tmp_path)
    assert set(masks.names) == set(BOXES)
    assert masks.of("green")[120, 250] and not masks.of("green")[0, 0]


def test_smallest_of_overlapping_masks_wins(tmp_path):
    for name, side in {"a_plate": 60, "b_cup": 20, "c_table": 90}.items():
        mask = np.zeros((100, 100), np.uint8)
        mask[:side, :side] = 1
        Image.fromarray(mask).save(tmp_path / f"{name}.png")
    masks = read_masks(tmp_path)
    at = lambda pixel: {number: name for name, number in masks.names.items()}[
        int(masks.labels[pixel, pixel])
    ]
    assert [at(5), at(30), at(80)] == ["b_cup", "a_plate", "c_table"]


def tree():
    nodes = [
        TreeNode(
            name="table",
            label="table",
            environment=True,
            box2d=Box2D(x0=0, y0=60, x1=640, y1=480),
            box3d=Box3D(position=(1, 0, -0.1), size=(1, 1, 0.1), yaw=0),
        )
    ]
    for name, (left, top, right, bottom) in BOXES.items():
        box = Box2D(x0=2 * left - 6, y0=2 * top, x1=2 * right, y1=2 * bottom + 8)
        place = Box3D(position=(1, 0, 0), size=(0.1, 0.1, 0.1), yaw=0)
        nodes.append(
            TreeNode(name=f"{name}_box", label="box", parent="table", box2d=box, box3d=place)
        )
    camera = Camera(width=640, height_px=480, fovy=0.7, height=0.5, pitch=0.5)
    return SceneTree(camera=camera, nodes=tuple(nodes))


@pytest.mark.parametrize("names", [{}, {"crimson": 3}, {"red_box": 3}])
def test_masks_without_the_name_of_an_object_go_to_the_box_that_they_overlap(names):
    numbers = labels().astype(np.int32)
    numbers[200:, :10] = 7
    masks, notes = matched_to(Masks(numbers, names, "sam.png"), tree())
    assert masks.names == {"red_box": 3, "blue_box": 5, "green_box": 9}
    assert notes == ("no object of the scene has the mask 7 of sam.png",)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({"mug": 4}, r"does not have: mug \(4\); it has the numbers 3, 5, 9"),
        ({"mug": "x"}, "is not NAME: number"),
        ([1], "JSON object"),
    ],
)
def test_wrong_names_give_one_message(tmp_path, names, message):
    Image.fromarray(labels()).save(tmp_path / "masks.png")
    (tmp_path / "names.json").write_text(json.dumps(names))
    with pytest.raises(EvidenceError, match=message):
        read_masks(tmp_path / "masks.png", tmp_path / "names.json")


def test_photographs_and_empty_folders_are_no_masks(tmp_path):
    with pytest.raises(EvidenceError, match="0 PNG files"):
        read_masks(tmp_path)
    noise = np.random.default_rng(0).integers(0, 60_000, (64, 64)).astype(np.uint16)
    Image.fromarray(noise).save(tmp_path / "masks.png")
    with pytest.raises(EvidenceError, match="no image of masks"):
        read_masks(tmp_path / "masks.png")
    Image.new("RGB", (64, 64)).save(tmp_path / "masks.png")
    with pytest.raises(EvidenceError, match="has colors"):
        read_masks(tmp_path / "masks.png")

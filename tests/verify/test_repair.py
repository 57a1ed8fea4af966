"""Patches express only the edits of Step 3; repairs are accepted only if they help."""

import json

import pytest
from pydantic import ValidationError

from neoworld_mjx.verify import Patch
from neoworld_mjx.verify.patch import apply
from tests.support import furniture as objects


def visible_shapes(spec):
    """Return the vertices of the visible shapes of each part."""
    return {
        part.name: [g.shape.surface()[0].tobytes() for g in part.geoms if g.role != "collision"]
        for part in spec.parts
    }


@pytest.mark.parametrize(
    "edit",
    [
        {"parts": {"door": {"geoms": []}}},
        {"parts": {"door": {"name": "x"}}},
        {"joints": {"hinge": {"axis": [0, 0, -1]}}},
        {"joints": {"hinge": {"type": "fixed"}}},
        {"joints": {"hinge": {"parent": "door"}}},
        {"joints": {"hinge": {"intent": None}}},
        {"geoms": {"leaf": {"shape": {"type": "box", "size": [1, 1, 1]}}}},
        {"geoms": {"leaf": {"role": "visual"}}},
        {"geoms": {"leaf": {"shrink": 0.1}}},
        {"remove": ["door"]},
        {"joints": {"hinge": {"damping": float("inf")}}},
        {"parts": {"door": {"mass": -1}}},
    ],
)
def test_a_patch_cannot_express_topology_or_visible_shapes(edit):
    with pytest.raises(ValidationError):
        Patch.model_validate(edit)


def test_a_patch_keeps_tree_types_axes_and_visible_shapes():
    spec = objects.cupboard()
    patch = Patch.model_validate(
        {
            "parts": {
                "door": {"mass": 3.0, "shift": (0.01, 0, 0)},
                "carcass": {"inertia": "derived"},
            },
            "joints": {"hinge": {"lower": -0.1, "upper": 1.0, "origin": (0.1, 0.2, 0.3)}},
            "geoms": {"leaf": {"shrink": 0.9}, "back": {"shrink": 0.95}},
        }
    )
    built, stale = apply(patch, spec)
    assert stale == ()
    assert visible_shapes(built) == visible_shapes(spec)
    assert [p.name for p in built.parts] == [p.name for p in spec.parts]
    for new, old in zip(built.joints, spec.joints, strict=True):
        assert (new.type, new.axis, new.parent, new.child) == (
            old.type, old.axis, old.parent, old.child,
        )  # fmt: skip
    assert built.part("door").mass == 3.0
    assert len(patch.changes()) == 8


def test_patches_join_and_survive_json():
    first = Patch.model_validate({"parts": {"door": {"shift": (0.1, 0, 0)}}})
    second = Patch.model_validate({"parts": {"door": {"shift": (0.2, 0, 0), "mass": "derived"}}})
    both = first.merged_with(second)
    assert both.parts["door"].shift == pytest.approx((0.3, 0, 0))
    assert Patch.model_validate_json(both.to_json()) == both
    assert "joints" not in json.loads(both.to_json())

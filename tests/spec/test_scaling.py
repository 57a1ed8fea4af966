"""Every number of an object declares how it scales, and shapes and joints scale as declared."""

import itertools
from typing import Annotated, get_args

import numpy as np
import pytest

from neoworld_mjx.spec import JointSpec, Mimic, ObjectSpec, PartSpec, Shape, scale
from neoworld_mjx.spec.base import Length, Number, ScalableSpec
from neoworld_mjx.spec.dimensions import UNSCALED, Motion
from neoworld_mjx.spec.object import AuthoredInertia
from neoworld_mjx.spec.primitives import BaseShape
from neoworld_mjx.spec.scale import joint_exponents, mimic_exponents
from tests.support import scenes
from tests.support.sample_shapes import SHAPES


def test_a_field_without_a_scaling_is_refused_when_its_class_is_defined():
    for annotation in (float, Number, tuple[Number, Number], float | None, list[tuple[int, int]]):
        with pytest.raises(TypeError, match=r"Bad\.width holds a number without a Scaling"):
            type("Bad", (BaseShape,), {"__annotations__": {"width": annotation}})
    with pytest.raises(TypeError, match=r"Bad\.pair mixes numbers that scale differently"):
        pair = tuple[Length, Annotated[float, UNSCALED]]
        type("Bad", (BaseShape,), {"__annotations__": {"pair": pair}})


def test_the_samples_have_every_shape():
    assert {type(shape) for shape in SHAPES.values()} == set(get_args(get_args(Shape)[0]))


@pytest.mark.parametrize("name", SHAPES)
def test_pieces_scale_with_the_shape(name: str):
    s, shape = 2.5, SHAPES[name]
    big = shape.scaled(s)
    for one, other in zip(shape.pieces(), big.pieces(), strict=True):
        assert other.kind == one.kind
        assert np.allclose(other.size, s * np.array(one.size))
        assert np.allclose(other.pos, s * np.array(one.pos))
        assert other.quat == one.quat
        if name != "panel":  # rounding decides which diagonals cut a symmetric outline
            assert np.allclose(_sorted(other.vertices), _sorted(s * np.array(one.vertices)))
    assert big.volume() == pytest.approx(s**3 * shape.volume())


def _sorted(points) -> np.ndarray:
    points = np.array(points).reshape(-1, 3)
    return points[np.lexsort(np.round(points, 9).T)]


def _models(model: type[ScalableSpec]) -> set[type[ScalableSpec]]:
    """Return a model with all models in its fields, through unions and tuples."""
    found, waiting = {model}, [model]
    while waiting:
        for field in waiting.pop().model_fields.values():
            types = [field.annotation]
            while types:
                one = types.pop()
                types += get_args(one)
                if isinstance(one, type) and issubclass(one, ScalableSpec) and one not in found:
                    found.add(one)
                    waiting.append(one)
    return found


def test_every_part_of_an_object_is_scalable():
    models = _models(ObjectSpec)
    assert set(get_args(get_args(Shape)[0])) | {ObjectSpec, JointSpec, Mimic} < models
    for model in models:
        assert set(model.scalings) == set(model.model_fields)


LAW_OF = ("lower", "armature", "stiffness", "damping", "friction", "effort", "velocity")
LAW = {"revolute": (0, 5, 4, 4.5, 4, 4, -0.5), "prismatic": (1, 3, 2, 2.5, 3, 3, 0.5)}


@pytest.mark.parametrize(("kind", "mass"), list(itertools.product(LAW, (None, 1.0))))
def test_exponents_of_joints_are_those_of_the_documented_law(kind: str, mass: float | None):
    joint = JointSpec(name="j", type=kind, parent="a", child="b", upper=1.0)
    child = PartSpec.model_construct(name="b", geoms=(), mass=mass)
    powers = joint_exponents(joint, child)
    for name, power in zip(LAW_OF, LAW[kind], strict=True):
        weighted = name not in ("lower", "velocity")
        assert powers[name] == power - (3 if weighted and mass else 0), name
    assert (powers["pos"], powers["axis"], powers["upper"]) == (1, 0, powers["lower"])


def test_a_mimic_scales_by_both_joints():
    joints = [
        JointSpec(name="j", type=kind, parent="a", child="b", upper=1.0)
        for kind in ("revolute", "prismatic")
    ]
    powers = [mimic_exponents(a, b) for a in joints for b in joints]
    assert powers == [(0, 0), (-1, 0), (1, 1), (0, 1)]
    mimic = Mimic(joint="j", multiplier=3.0, offset=0.5)
    assert mimic.scaled(2.0, Motion(slides=True)) == Mimic(joint="j", multiplier=6.0, offset=1.0)


def test_an_authored_inertia_scales_with_the_square_of_length():
    spec = scenes.block("a", (0.1, 0.2, 0.3))
    inertia = AuthoredInertia(pos=(0.1, 0, 0), moments=(2, 3, 4), products=(0.1, 0.2, 0.3))
    part = spec.parts[0].model_copy(update={"mass": 2.0, "inertia": inertia})
    (big,) = scale(spec.model_copy(update={"parts": (part,)}), 2.0).parts
    assert big.mass == 2.0 and big.inertia.pos == (0.2, 0, 0)
    assert np.allclose(big.inertia.tensor(), 4 * inertia.tensor())

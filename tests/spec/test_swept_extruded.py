import math

import numpy as np
import pytest
from pydantic import ValidationError

from neoworld_mjx.spec import Extrusion, Lathe, RoundedBox, Sweep
from neoworld_mjx.spec.convex import mass_properties, planes


def ring(radius: float, count: int, arc: float = 2 * math.pi) -> tuple:
    whole = arc == 2 * math.pi
    angles = np.linspace(0, arc, count, endpoint=not whole)
    return tuple((radius * math.cos(a), radius * math.sin(a), 0.0) for a in angles)


TORUS = Sweep(path=ring(0.05, 32), width=(0.01,), thickness=(0.01,), closed=True, sectors=16)
STRAP = Sweep(path=ring(0.03, 9, math.pi), width=(0.012,), thickness=(0.004,))
HOOK = Sweep(
    path=((0, 0, 0), (0, 0, 0.1), (0.02, 0, 0.12), (0.05, 0.02, 0.12)),
    width=(0.01, 0.01, 0.008, 0.004),
    thickness=(0.01, 0.01, 0.008, 0.004),
)
ROD = Sweep(path=((0, 0, 0), (0, 0, 0.2)), width=(0.01,), thickness=(0.02,))
L_SHAPE = Extrusion(outline=((0, 0), (2, 0), (2, 1), (1, 1), (1, 3), (0, 3)), height=0.5)
PANEL = Extrusion(
    outline=((0, 0), (0, 2), (3, 2), (3, 0)),
    holes=(((0.5, 0.5), (1, 0.5), (1, 1.5), (0.5, 1.5)), ((2, 1), (2.5, 1.2), (2.2, 1.7))),
    height=0.02,
)
SPOON = Lathe(profile=((0, 0), (0.01, 0.003), (0.02, 0.01)), thickness=0.002, oval=0.7)
CUP = Lathe(
    profile=((0, 0), (0.021, 0), (0.021, 0.003), (0.029, 0.015), (0.0375, 0.06)), thickness=0.0035
)
SHAPES = [
    SPOON,
    CUP,
    TORUS,
    STRAP,
    HOOK,
    ROD,
    L_SHAPE,
    PANEL,
    RoundedBox(size=(0.2, 0.1, 0.05), radius=0.01),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.type)
def test_pieces_do_not_overlap(shape):
    random = np.random.default_rng(0)
    result = [planes(piece) for piece in shape.pieces()]
    corners = np.vstack([np.array(piece.vertices) for piece in shape.pieces()])
    points = random.uniform(corners.min(axis=0), corners.max(axis=0), (20000, 3))
    depth = np.array([(p[:, 3] - points @ p[:, :3].T).min(axis=1) for p in result])
    assert np.sum(depth > 1e-9, axis=0).max() <= 1
    assert np.sum(depth > 1e-9) > 100


def test_volumes_against_formulas():
    volume = sum(mass_properties(piece)[0] for piece in TORUS.pieces())
    # Pappus, with the polygon in place of the circle.
    section = 0.5 * 16 * 0.005**2 * math.sin(2 * math.pi / 16)
    assert volume == pytest.approx(2 * math.pi * 0.05 * section, rel=0.01)
    volume = sum(mass_properties(piece)[0] for piece in L_SHAPE.pieces())
    assert volume == pytest.approx(4 * 0.5)
    assert len(L_SHAPE.pieces()) == 2
    volume = sum(mass_properties(piece)[0] for piece in PANEL.pieces())
    assert volume == pytest.approx((6 - 0.5 - 0.155) * 0.02)


def strip(*points) -> Sweep:
    return Sweep(path=((0, 0, 0), *points), width=(0.01,), thickness=(0.01,))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sweep(path=ring(0.01, 12), width=(0.03,), thickness=(0.03,)), "sharply"),
        (lambda: Sweep(path=ring(1, 6), width=(0.1, 0.1), thickness=(0.1,)), "1 value or 6"),
        (lambda: Extrusion(outline=((0, 0), (1, 1), (1, 0), (0, 1)), height=1), "area|cross"),
        (
            lambda: Extrusion(
                outline=((0, 0), (1, 0), (1, 1), (0, 1)),
                holes=(((2, 2), (3, 2), (3, 3)),),
                height=1,
            ),
            "inside",
        ),
        (lambda: RoundedBox(size=(1, 1, 0.1), radius=0.06), "too large"),
        (
            lambda: strip((0.1, 0, 0), (0.01, 0.01, 0)),
            r"turns by 174 degrees at path\[1\], at most 120",
        ),
        (lambda: strip((0.1, 0, 0), (0.1, 0, 0)), r"repeats a point: path\[1\] and path\[2\]"),
        (
            lambda: Lathe(profile=((0, 0), (0.05, 0), (0.05, 0.1), (0.04, 0.08))),
            r"from profile\[2\] \(0.05, 0.1\) to profile\[3\] \(0.04, 0.08\)",
        ),
        (
            lambda: Lathe(profile=((0, 0), (0.05, 0), (0, 0.1)), thickness=0.002),
            r"only at its first point, not at profile\[2\] \(0, 0.1\)",
        ),
        (lambda: Lathe(profile=((0, 0), (-0.05, 0), (0, 0.1))), r"profile\[1\] is \(-0.05, 0\)"),
        (
            lambda: Extrusion(outline=((0, 0), (2, 2), (2, 0), (0, 1)), height=0.1),
            r"edges from outline\[0\] and outline\[2\]",
        ),
    ],
)
def test_invalid_shapes_are_refused_with_the_reason(make, words):
    with pytest.raises(ValidationError, match=words):
        make()

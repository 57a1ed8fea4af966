"""Annotations of the bundled photograph, as a person would make them."""

import math

from neoworld_mjx.spec import Box2D, Camera
from neoworld_mjx.view.annotation import AnnotatedObject, Annotation

SAUCER, CUP = (77, 67, 480, 389), (172, 17, 409, 308)
"""Boxes in pixels of examples/coffee.png."""
PITCH_DEG, HEIGHT_M, FOVY_DEG = 54, 0.283, 20


def coffee(cup_kind: str = "cup") -> Annotation:
    """Return a cup on a saucer on a table."""
    camera = Camera(
        width=600,
        height_px=400,
        fovy=math.radians(FOVY_DEG),
        height=HEIGHT_M,
        pitch=math.radians(PITCH_DEG),
    )
    saucer = AnnotatedObject(
        name="saucer", kind="bowl", material="ceramic", size=(0.12, 0.12, 0.016), box=_box(SAUCER)
    )
    cup = AnnotatedObject(
        name="cup", kind=cup_kind, material="ceramic", parent="saucer", box=_box(CUP)
    )
    return Annotation(camera=camera, objects=(saucer, cup))


def _box(corners: tuple[float, float, float, float]) -> Box2D:
    x0, y0, x1, y1 = corners
    return Box2D(x0=x0, y0=y0, x1=x1, y1=y1)

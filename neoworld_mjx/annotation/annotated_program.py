"""Programs of annotated objects, made from templates and simple shapes."""

from ..templates import template
from .annotation import EXISTING_PROGRAM, SHAPES, WRITTEN_BY_MODEL, AnnotatedObject

RGB = tuple[float, float, float]
_LATHE = "body.add(lathe([(0, 0), ({inner!r}, 0), ({r!r}, {z!r})], thickness={wall!r}))"
_CALLS = {
    "box": ("box", "body.add(box(({x!r}, {y!r}, {z!r})), by='bottom')"),
    "cylinder": ("cylinder", "body.add(cylinder({r!r}, {z!r}), by='bottom')"),
    "ball": ("sphere", "body.add(sphere({r!r}), by='bottom')"),
    "bowl": ("lathe", _LATHE),
    "cup": ("lathe", _LATHE),
}
"""SDK function that creates a shape, and the program line that calls the function, by kind."""


def program_of(obj: AnnotatedObject, size: tuple[float, float, float], rgb: RGB) -> str | None:
    """Return the program of an annotated object.

    The result is None if the object is a support of the environment, if it keeps its existing
    program, or if a model writes its program.

    Args:
        obj: the object.
        size: edge lengths of the object's box [m].
        rgb: color of the object, 0 to 1.
    """
    if obj.kind in (WRITTEN_BY_MODEL, EXISTING_PROGRAM) or obj.support:
        return None
    if obj.kind not in SHAPES:
        object_template = template(obj.kind)
        return object_template.program(dict(object_template.of_box(size)))
    x, y, z = (round(v, 4) for v in size)
    r = round(min(x, y) / 2, 4)
    wall = round(min(max(0.06 * r, 0.002), 0.6 * r, 0.4 * z), 4)
    inner = round((0.5 if obj.kind == "bowl" else 0.75) * r, 4)
    red, green, blue = (round(v, 3) for v in rgb)
    function, line = _CALLS[obj.kind]
    return (
        f"from neoworld_mjx.program.sdk import Object, {function}\n\n"
        f'thing = Object("{obj.name}")\n'
        f'look = thing.material("{obj.material}_seen", like="{obj.material}", '
        f"rgb=({red}, {green}, {blue}))\n"
        'body = thing.part("body", material=look)\n'
        f"{line.format(x=x, y=y, z=z, r=r, wall=wall, inner=inner)}\n"
    )

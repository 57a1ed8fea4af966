"""Request for the objects of a scene in a further photograph of it."""

import numpy as np
from jaxtyping import UInt8
from pydantic import Field

from ..mllm import Fallback, Model, Picture, Request, ask_or_record, package_text
from ..spec import Box2D, SceneTree
from .draw import draw_parse
from .object_schema import ParsedBox, ResponsePart
from .photo import Photo

PhotoRGB = UInt8[np.ndarray, "row column 3"]
PROMPT = (
    "Two photographs show the same scene from different places. The picture `first` is the first "
    "one, with the boxes and names of its objects:\n\n{listing}\n\nThe picture `further` has "
    "{width} x {height} pixels. Give the box of each of these objects that it shows: tight around "
    "the visible pixels, in pixels of `further`. Recognize an object by its shape, its color and "
    "its neighbors, not by its place in the picture. Tell equal objects, such as two cans, apart "
    "by their neighbors; leave out an object that is hidden, or that you cannot tell from another."
)


class MarkedObject(ResponsePart):
    """An object of the first photograph in the further one."""

    name: str = Field(description="Its name in the first photograph.")
    box: ParsedBox


class MarkedPhoto(ResponsePart):
    """The objects that a further photograph shows."""

    objects: list[MarkedObject]


async def boxes_of_photo(
    photo: Photo, tree: SceneTree, further: PhotoRGB, models: Model, fallbacks: list[Fallback]
) -> dict[str, Box2D]:
    """Ask a model for the boxes of the objects in a further photograph.

    Names that the tree lacks, and boxes without area in the picture, are dropped.

    Args:
        photo: the first photograph.
        tree: its scene tree.
        further: the further photograph.
        models: the models.
        fallbacks: list to which the reason of a failed request is appended.

    Returns:
        The boxes in pixels of `further`, by the object's name; empty if the request failed.
    """
    request = marking_request(photo, tree, further)
    response = await ask_or_record(models, request, "no boxes of its objects", fallbacks)
    height, width = further.shape[:2]
    names = {node.name for node in tree.nodes if not node.slab}
    boxes = {}
    for item in () if response is None else response.objects:
        x0, x1 = (min(max(v, 0.0), float(width)) for v in (item.box.left, item.box.right))
        y0, y1 = (min(max(v, 0.0), float(height)) for v in (item.box.top, item.box.bottom))
        if item.name in names and x0 < x1 and y0 < y1:
            boxes[item.name] = Box2D(x0=x0, y0=y0, x1=x1, y1=y1)
    return boxes


def marking_request(photo: Photo, tree: SceneTree, further: PhotoRGB) -> Request[MarkedPhoto]:
    """Return the request for the objects in a further photograph."""
    height, width = further.shape[:2]
    listing = "\n".join(
        f"- {node.name}: {node.label}" + f"; {node.description}" * bool(node.description)
        for node in tree.nodes
        if not node.slab
    )
    first = draw_parse(photo, tree)
    return Request(
        role="reasoner",
        name="parse:further",
        system=package_text(__package__, "reasoner"),
        prompt=PROMPT.format(listing=listing, width=width, height=height),
        schema=MarkedPhoto,
        pictures=[Picture("first", first.data), Picture("further", further)],
    )

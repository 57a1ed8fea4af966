"""Drawing of a parsed scene on the photograph: 2D boxes with name tags.

The picture is part of the request to the critic, and its pixels are part of the request's key.
Every machine must therefore draw the same pixels. Boxes are drawn directly into the array, and tags
with Pillow's bitmap font, because the rounding of a rasterizer may change between versions.
"""

from collections.abc import Iterable
from functools import cache

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image, ImageDraw, ImageFont

from ..mllm import Picture
from ..spec import SceneTree, TreeNode
from .outlines import NEAR_M, edges_in_view
from .photo import Photo

GREY = (170, 170, 170)
COLOURS = (
    (255, 70, 70),
    (70, 220, 90),
    (80, 150, 255),
    (255, 200, 40),
    (230, 90, 255),
    (60, 225, 225),
    (255, 140, 60),
    (190, 255, 110),
)
"""Colors of objects by their support; supports are numbered in the order of the nodes."""

HEAD = 0.3
"""Length and width of an arrow's head, relative to the half length and the width of the base."""
Region = tuple[int, int, int, int]


def draw_parse(photo: Photo, tree: SceneTree, *, draw_3d_boxes: bool = False) -> Picture:
    """Draw a parsed scene on the resized picture.

    Objects on the same support share a color; with 3D boxes, neighbors in the list differ in color.
    Boxes of partly hidden objects are dashed. Boxes of environment supports are thin and gray.

    Args:
        photo: the photograph.
        tree: the parsed scene, in pixels of the original photo.
        draw_3d_boxes: if True, also draw the projected edges of the 3D boxes, and an arrow
            from the center of each base to the front. Their pixels depend on the rounding of the
            machine, so no request contains such a picture.
    """
    canvas = np.array(photo.rgb)
    height, width = canvas.shape[:2]
    colours = _colours(tree, by_support=not draw_3d_boxes)
    glyph = 1 if max(width, height) < 900 else 2
    line = max(2, round(max(width, height) / 400))
    if draw_3d_boxes:
        canvas = _edges(canvas, photo, tree, colours)
    boxes = {node.name: _pixels(node, photo) for node in tree.nodes}
    # Draw environment supports first and then objects; small boxes last, so that they are on top.
    order = sorted(tree.nodes, key=lambda node: (not node.environment, -_area(boxes[node.name])))
    for node in order:
        low = _side(boxes[node.name]) < 8 * line  # A thick frame would hide the object.
        thickness = 1 if node.environment or low else line
        _frame(canvas, boxes[node.name], colours[node.name], thickness, dashed=node.occluded)
    tags: list[Region] = []
    for node in reversed(order):
        tag = name_tag(node.name, glyph)
        corner = _place(tag.shape, boxes[node.name], (width, height), tags, boxes.values())
        stamp(canvas, tag, corner, colours[node.name])
        tags.append((corner[0], corner[1], corner[0] + tag.shape[1], corner[1] + tag.shape[0]))
    return Picture("parse", canvas)


def _colours(tree: SceneTree, *, by_support: bool) -> dict[str, tuple[int, int, int]]:
    groups = {node.name: node.parent if by_support else node.name for node in tree.nodes}
    order = list(dict.fromkeys(groups[node.name] for node in tree.nodes if not node.environment))
    return {
        node.name: GREY
        if node.environment
        else COLOURS[order.index(groups[node.name]) % len(COLOURS)]
        for node in tree.nodes
    }


def _pixels(node: TreeNode, photo: Photo) -> Region:
    """Return a node's 2D box in integer pixels of the resized picture; each side is at least 2."""
    width, height = photo.size
    sx, sy = width / photo.original_size[0], height / photo.original_size[1]
    box = node.box2d
    x0, y0 = int(np.floor(box.x0 * sx + 0.5)), int(np.floor(box.y0 * sy + 0.5))
    x1, y1 = int(np.floor(box.x1 * sx + 0.5)), int(np.floor(box.y1 * sy + 0.5))
    x0, y0 = min(max(x0, 0), width - 2), min(max(y0, 0), height - 2)
    return x0, y0, min(max(x1, x0 + 2), width), min(max(y1, y0 + 2), height)


def _side(box: Region) -> int:
    """Return the length of the shorter side of a box."""
    return min(box[2] - box[0], box[3] - box[1])


def _area(box: Region) -> int:
    return (box[2] - box[0]) * (box[3] - box[1])


def _frame(
    canvas: UInt8[np.ndarray, "h w 3"],
    box: Region,
    colour: tuple[int, int, int],
    thickness: int,
    *,
    dashed: bool,
) -> None:
    """Draw the frame of a box inwards from its outer edge, with a black line inside."""
    for inset, width, ink in ((thickness, 1, (0, 0, 0)), (0, thickness, colour)):
        x0, y0, x1, y1 = box[0] + inset, box[1] + inset, box[2] - inset, box[3] - inset
        if x1 - x0 < 1 or y1 - y0 < 1:
            continue
        across = _dashes(x1 - x0, thickness, dashed)
        along = _dashes(y1 - y0, thickness, dashed)
        for k in range(width):
            canvas[min(y0 + k, y1 - 1), x0:x1][across] = ink
            canvas[max(y1 - 1 - k, y0), x0:x1][across] = ink
            canvas[y0:y1, min(x0 + k, x1 - 1)][along] = ink
            canvas[y0:y1, max(x1 - 1 - k, x0)][along] = ink


def _dashes(length: int, thickness: int, dashed: bool) -> Bool[np.ndarray, " length"]:
    if not dashed:
        return np.ones(length, bool)
    period = 8 * thickness
    index = np.arange(length)
    # The pattern is symmetric, so that every corner is drawn.
    return np.minimum(index, length - 1 - index) % period < period // 2


@cache
def name_tag(name: str, glyph: int) -> Bool[np.ndarray, "h w"]:
    """Return the mask of a name in the bitmap font, with a margin, magnified by `glyph`."""
    font = ImageFont.load_default_imagefont()
    left, top, right, bottom = font.getbbox(name)
    image = Image.new("1", (int(right - left) + 4, int(bottom - top) + 2), 0)
    ImageDraw.Draw(image).text((2 - left, 1 - top), name, fill=1, font=font)
    mask = np.array(image, dtype=bool)
    return mask.repeat(glyph, axis=0).repeat(glyph, axis=1)


def _place(
    shape: tuple[int, ...],
    box: Region,
    size: tuple[int, int],
    tags: list[Region],
    boxes: Iterable[Region],
) -> tuple[int, int]:
    """Choose a position that covers the least of other tags.

    Among equals, prefer those that hide the fewest small or low objects, then those that cross the
    fewest frames.
    """
    height, width = shape[0], shape[1]
    x0, y0, x1, y1 = box
    candidates = [
        (x, y)
        for y in (y0 - height, y0, y1 - height, y1, (y0 + y1 - height) // 2)
        for x in (x0, x1 - width, (x0 + x1 - width) // 2, x1, x0 - width)
    ]
    frames = list(boxes)

    def cost(position: tuple[int, int]) -> tuple[int, int, int, int]:
        x, y = _inside(position, (width, height), size)
        region = (x, y, x + width, y + height)
        shift = abs(x - position[0]) + abs(y - position[1])
        return (
            sum(overlap(region, other) for other in tags),
            sum(4 * overlap(region, other) > _side(other) ** 2 for other in frames),
            sum(_crosses(region, other) for other in frames),
            shift,
        )

    return _inside(min(candidates, key=cost), (width, height), size)


def _inside(
    position: tuple[int, int], tag: tuple[int, int], size: tuple[int, int]
) -> tuple[int, int]:
    x = min(max(position[0], 0), max(size[0] - tag[0], 0))
    y = min(max(position[1], 0), max(size[1] - tag[1], 0))
    return x, y


def overlap(a: Region, b: Region) -> int:
    """Return the number of pixels that two regions share."""
    return max(0, min(a[2], b[2]) - max(a[0], b[0])) * max(0, min(a[3], b[3]) - max(a[1], b[1]))


def _crosses(tag: Region, frame: Region) -> bool:
    within = tag[0] >= frame[0] and tag[1] >= frame[1] and tag[2] <= frame[2] and tag[3] <= frame[3]
    return overlap(tag, frame) > 0 and not within


def stamp(
    canvas: UInt8[np.ndarray, "h w 3"],
    tag: Bool[np.ndarray, "th tw"],
    at: tuple[int, int],
    colour: tuple[int, int, int],
) -> None:
    """Draw a tag, black on a color, with its upper left corner at a pixel."""
    x, y = at
    under = canvas[y : y + tag.shape[0], x : x + tag.shape[1]]
    mask = tag[: under.shape[0], : under.shape[1]]
    under[~mask] = colour
    under[mask] = 0


REGION_PX = 900
"""Approximate length of the longer side of an enlarged region [px]."""


def draw_region(picture: Picture, box: tuple[float, float, float, float]) -> Picture:
    """Enlarge a region of a picture, with rulers whose numbers are pixels of the whole picture.

    Args:
        picture: the picture.
        box: left, top, right and bottom of the region [px]; it is clipped at the picture's edges.
    """
    width, height = picture.size
    left, right = sorted(min(max(round(value), 0), width) for value in box[::2])
    top, bottom = sorted(min(max(round(value), 0), height) for value in box[1::2])
    left, top = min(left, width - 2), min(top, height - 2)
    right, bottom = max(right, left + 2), max(bottom, top + 2)
    factor = max(1.0, REGION_PX / max(right - left, bottom - top))
    region = Image.fromarray(picture.rgb[top:bottom, left:right])
    size = round(region.width * factor), round(region.height * factor)
    canvas = np.array(region.resize(size, Image.Resampling.BICUBIC))
    step = next(s for s in (1, 2, 5, 10, 20, 50, 100, 200, 500) if s * factor >= 40)
    for axis, (low, high) in enumerate(((left, right), (top, bottom))):
        for value in range(-(-low // step) * step, high, step):
            at, tag = round((value - low) * factor), name_tag(str(value), 1)
            spots = (slice(0, 8), at) if axis == 0 else (at, slice(0, 8))
            canvas[spots] = COLOURS[0]
            corner = (at + 2, 0) if axis == 0 else (8, max(at - tag.shape[0] // 2, 0))
            covers = axis == 0 and at < 30  # The numbers of the left ruler are there.
            inside = corner[0] + tag.shape[1] <= size[0] and corner[1] + tag.shape[0] <= size[1]
            if inside and not covers:
                stamp(canvas, tag, corner, COLOURS[3])
    return Picture("zoom", canvas)


def _edges(
    canvas: UInt8[np.ndarray, "h w 3"],
    photo: Photo,
    tree: SceneTree,
    colours: dict[str, tuple[int, int, int]],
) -> UInt8[np.ndarray, "h w 3"]:
    image = Image.fromarray(canvas)
    draw = ImageDraw.Draw(image)
    scale = np.array(photo.size) / np.array(photo.original_size)
    for node in tree.nodes:
        for start, end in edges_in_view(tree.camera, node.box3d.corners(node.base_tilt)):
            ends = [tuple((point * scale).tolist()) for point in (start, end)]
            draw.line(ends, fill=colours[node.name], width=1)
        if not node.environment:  # An arrow leads from the center of the base to the front.
            corners = node.box3d.corners(node.base_tilt)
            middle, front = corners[::2].mean(axis=0), corners[4::2].mean(axis=0)
            back, side = (front - middle) * HEAD, (corners[6] - corners[4]) * HEAD / 2
            points = np.array([middle, front, front - back + side, front - back - side])
            pixels, depth = tree.camera.project(points)
            if depth.min() > NEAR_M:
                tail, tip, *barbs = [tuple(point) for point in (pixels * scale).tolist()]
                draw.line([tail, tip], fill=colours[node.name], width=3)
                draw.polygon([tip, *barbs], fill=colours[node.name])
    return np.array(image)

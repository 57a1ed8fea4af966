"""Arrays of a compiled scene for jitted functions, and their padding to buckets.

Scenes padded to the same bucket have the same shapes, so they share compiled functions. Padded
entries touch nothing and are not moved, rendered or scored.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from neoworld_kernels import SPARE, Colliders, PieceGroup

from .array_types import AnyArray
from .layout import Arrangement, Layout, Poses, heights, place
from .photo_view import PhotoView
from .support import no_support

PADDING_DEPTH_M = 1e4
"""Depth of padded objects below the scene [m]."""


class SceneArrays(eqx.Module):
    """Arrays for placing and scoring candidates, padded or not; an argument of jitted functions.

    `SceneModel` adds the scene's data on the host.
    """

    arrangement: Arrangement
    """Parameters of `place`, in single precision."""
    samples: Float[AnyArray, "object sample 3"]
    """Surface points in object frames [m]."""
    outline: Float[AnyArray, "object point 3"]
    """Extreme points of each object in evenly spread directions, in object frames [m]."""
    round: Bool[AnyArray, " object"]
    """True for objects that are symmetric about their frame's z axis."""
    colliders: Colliders
    """Canonical colliders in object frames."""
    photo: PhotoView
    """Camera, boxes and depths of the photograph."""
    optimised: Bool[AnyArray, " object"]
    """True for objects that the search moves: all but environment supports and objects whose pose
    is known."""
    resized: Bool[AnyArray, " object"]
    """True for objects whose size the search changes."""
    movable: Bool[AnyArray, " object"]
    """True for objects whose base is free."""
    deviations: Float[AnyArray, "object 4"]
    """Standard deviations that the photograph leaves: of x and y in the frame of the support [m],
    of the yaw [rad] and of the log scale. Zeros for objects that were not aligned."""
    diagonal: Float[AnyArray, " object"]
    """Horizontal bounding-box diagonal [m]."""
    corners: Float[AnyArray, "object 8 3"]
    """Corners of each object's bounding box in its frame, at its joint state [m]."""
    pair_mask: Bool[AnyArray, "object object"]
    """True for pairs of different objects that are not both environment supports, whose penetration
    does not depend on the layout."""
    joint_object: Int[AnyArray, " joint"]
    """Object of each joint except free joints."""
    joint_slides: Bool[AnyArray, " joint"]
    """True for sliding joints, whose shift is in m instead of rad."""

    @property
    def count(self) -> int:
        """Length of the object axis."""
        return self.diagonal.shape[0]

    @property
    def arrays(self) -> "SceneArrays":
        """The arrays without the host data. Scenes with equal shapes share compiled functions."""
        return SceneArrays(**{name: vars(self)[name] for name in SceneArrays.__dataclass_fields__})

    def place(self, layouts: Layout) -> Poses:
        """Place every object of every candidate; see `layout.place`.

        This method may be jitted, vmapped over further leading axes of the layouts, and
        differentiated. It is compiled once for all scenes with equally many objects.
        """
        return _place(self.arrangement, layouts)


_place = jax.jit(place, inline=True)


class Bucket(NamedTuple):
    """Lengths of the padded axes."""

    objects: int
    joints: int
    faces: int
    """Planes of a polytope or sector."""
    box: int
    capsule: int
    cylinder: int
    ellipsoid: int
    polytope: int
    sector: int


SMALLEST_BUCKET = Bucket(16, 16, 64, 64, 16, 32, 16, 128, 32)
"""Bucket of a table with a few objects. Larger buckets multiply all lengths by one power of two,
except the number of faces, which has a separate power of two."""


def bucket_of(scene: SceneArrays) -> Bucket:
    """Return the smallest bucket into which a scene fits."""
    groups = scene.colliders._asdict()
    lengths = Bucket(
        objects=scene.count,
        joints=len(scene.joint_object),
        faces=max(group.planes.shape[1] for group in groups.values()),
        **{kind: len(group.owner) for kind, group in groups.items()},
    )

    def multiple(n: int, smallest: int) -> int:
        return 1 << max(0, -(-n // smallest) - 1).bit_length()

    faces = SMALLEST_BUCKET.faces * multiple(lengths.faces, SMALLEST_BUCKET.faces)
    factor = max(
        multiple(*pair) for pair in zip(lengths._replace(faces=1), SMALLEST_BUCKET, strict=True)
    )
    return Bucket(*(n * factor for n in SMALLEST_BUCKET))._replace(faces=faces)


def pad_scene(scene: SceneArrays) -> SceneArrays:
    """Pad a scene's arrays to the smallest bucket into which they fit."""
    b = bucket_of(scene)
    n, photo = b.objects, scene.photo
    pair_mask = np.zeros((n, n), bool)
    pair_mask[: scene.count, : scene.count] = scene.pair_mask
    fills = {"boxes": np.array([0.0, 0.0, 1.0, 1.0]), "depth": 1.0, "diagonal": 1.0}
    pad = lambda owner, *names: {
        name: pad_axis(getattr(owner, name), n, fills.get(name, 0)) for name in names
    }
    seen = pad(photo, "boxes", "parsed", "depth", "scored", "fully_visible", "occludes")
    groups = scene.colliders._asdict().items()
    padded = SceneArrays(
        arrangement=pad_arrangement(scene.arrangement, n),
        colliders=Colliders(
            *(_pad_pieces(g, getattr(b, kind), b.faces, n - 1) for kind, g in groups)
        ),
        photo=photo._replace(**seen),
        pair_mask=pair_mask,
        joint_object=pad_axis(scene.joint_object, b.joints, n - 1),
        joint_slides=pad_axis(scene.joint_slides, b.joints),
        **pad(
            scene, "samples", "outline", "round", "optimised", "resized", "movable", "deviations"
        ),
        **pad(scene, "diagonal", "corners"),
    )
    return on_device(padded)


def pad_arrangement(a: Arrangement, objects: int) -> Arrangement:
    """Pad an arrangement on the host to `objects` objects; padding lies far below the scene."""
    count, upright = len(a.parent), np.array([1.0, 0.0, 0.0, 0.0])
    ancestors = np.eye(objects)
    ancestors[:count, :count] = a.ancestors
    fills = {"z": -PADDING_DEPTH_M, "tilt": upright, "parent": -1}
    own = {name: x for name, x in a._asdict().items() if name not in ("ancestors", "support")}
    return Arrangement(
        ancestors=ancestors,
        support=jax.tree.map(lambda x, empty: pad_axis(x, objects, empty), a.support, no_support()),
        **{name: pad_axis(x, objects, fills.get(name, 0)) for name, x in own.items()},
    )


def object_bucket(count: int) -> int:
    """Return the length of the object axis to which `count` objects are padded."""
    return SMALLEST_BUCKET.objects << (-(-count // SMALLEST_BUCKET.objects) - 1).bit_length()


def pad_objects(tree: Any, objects: int) -> Any:
    """Pad the object axis of arrays [pop, object, ...] on the host."""
    pad = lambda x: np.swapaxes(pad_axis(np.swapaxes(np.asarray(x), 0, 1), objects), 0, 1)
    return jax.tree.map(pad, tree)


_heights = jax.jit(heights)


HEIGHTS_AT_ONCE = 16
"""Number of candidates whose heights are computed at once, unless there is only one."""


def snapped_heights(arrangement: Arrangement, layout: Layout) -> Float[np.ndarray, "pop object"]:
    """Return the snapped heights of the candidates' objects [m], shape [pop, object].

    The computation is compiled once for each bucket, and once more for single candidates.
    """
    pop, count = layout.yaw.shape
    padded_count = object_bucket(count)
    # Jitted, so that heights are rounded as in a search.
    padded = on_device(pad_arrangement(arrangement, padded_count))
    layout, parts = pad_objects(layout, padded_count), []
    for first in range(0, pop, HEIGHTS_AT_ONCE):
        rows = np.arange(first, first + (HEIGHTS_AT_ONCE if pop > 1 else 1))
        chunk = jax.tree.map(lambda x, rows=rows: x[np.minimum(rows, pop - 1)], layout)
        parts.append(np.asarray(_heights(padded, on_device(chunk))))
    return np.concatenate(parts)[:pop, :count]


def _pad_pieces(group: PieceGroup, pieces: int, faces: int, owner: int) -> PieceGroup:
    """Pad a group with empty pieces that are far from all objects."""
    spare = np.array([0.0, 0.0, 0.0, SPARE])
    planes = np.moveaxis(pad_axis(np.moveaxis(np.asarray(group.planes), 1, 0), faces, spare), 0, 1)
    empty = np.tile(spare, (faces, 1))
    if faces:
        empty[0, 3] = -1.0
    rows = {
        "owner": pad_axis(group.owner, pieces, owner),
        "pos": pad_axis(group.pos, pieces, np.array([0.0, 0.0, PADDING_DEPTH_M])),
        "rot": pad_axis(group.rot, pieces, np.eye(3)),
        # Nonzero, since distances are divided by the sizes of ellipsoids and repeats of sectors.
        "size": pad_axis(group.size, pieces, np.array([1.0, 1e-6, 1e-6])),
        "planes": pad_axis(planes, pieces, empty),
        "extent": pad_axis(group.extent, pieces),
    }
    return PieceGroup(**on_device(rows))


def pad_axis(x: Any, length: int, fill: Any = 0) -> np.ndarray:
    """Lengthen the leading axis of an array to `length`, on the host, with copies of `fill`."""
    x = np.asarray(x)
    out = np.empty((length, *x.shape[1:]), x.dtype)
    out[: len(x)], out[len(x) :] = x, fill
    return out


def on_device(tree: Any) -> Any:
    """Put the arrays of a tree on the device in single precision, without compiling anything."""

    def put(x: Any) -> Array:
        x = np.asarray(x)
        return jax.device_put(x.astype(np.float32) if x.dtype == np.float64 else x)

    return jax.tree.map(put, tree)

"""Accuracy of sampled penetration against MuJoCo's exact depth, over random pairs of colliders.

D_pen samples a fixed number of surface points, so it misses or underestimates shallow overlaps.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from neoworld_kernels import Colliders, PieceGroup, pair_depth_reference
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import spearmanr

from neoworld_mjx.physics.colliders import collect_colliders
from neoworld_mjx.physics.exact import geom_distance, start_state
from neoworld_mjx.physics.sampling import surface_samples
from neoworld_mjx.spec import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Mesh,
    SceneObject,
    SceneSpec,
    Shape,
    Sphere,
)
from neoworld_mjx.spec.pose import matrix

from ..rows import Row
from .table_scenes import single

KINDS = ("box", "sphere", "capsule", "cylinder", "ellipsoid", "polytope")
DEEP = 0.005
"""Depth [m] above which sampling should not miss overlaps."""
OVERLAP = 0.03
"""Largest overlap [m] along the direction in which two colliders are pushed together."""
SAMPLES_OF_EACH = 256
"""Surface samples of each solid."""

FAR = np.float32(1e3)
"""Distance [m] to which pieces are moved that must not touch."""


class Pairs(NamedTuple):
    """Random pairs of colliders; depths [m], zero where they do not touch."""

    kinds: NDArray
    """[pair, 2], indices into `KINDS`."""
    exact: NDArray
    sampled: NDArray


class AccuracyRow(Row):
    """Accuracy of sampling over the pairs of two kinds."""

    first: str
    second: str
    pairs: int
    touching: int
    deep: int
    """Number of pairs deeper than `DEEP`."""
    missed: float
    """Share of the touching pairs that sampling finds apart."""
    missed_deep: float
    """Share of the deep pairs that sampling finds apart."""
    spearman: float
    """Rank correlation of sampled and exact depth over the touching pairs."""
    ratio: float
    """Median of sampled over exact depth of the deep pairs."""
    false: int
    """Number of pairs that sampling finds deeper than 10 micrometres and MuJoCo apart."""


def accuracy(pairs: Pairs) -> list[AccuracyRow]:
    """Summarize pairs by kinds; the first row, of "all", is over all of them."""
    low, high = pairs.kinds.min(axis=1), pairs.kinds.max(axis=1)
    rows = [_row("all", "all", pairs, np.ones(len(low), bool))]
    for a, b in itertools.combinations_with_replacement(range(len(KINDS)), 2):
        where = (low == a) & (high == b)
        if where.any():
            rows.append(_row(KINDS[a], KINDS[b], pairs, where))
    return rows


def _row(first: str, second: str, pairs: Pairs, where: NDArray) -> AccuracyRow:
    exact, sampled = pairs.exact[where], pairs.sampled[where]
    touch, deep = exact > 0, exact > DEEP
    share = lambda x: float(np.mean(x)) if len(x) else 0.0
    return AccuracyRow(
        first=first,
        second=second,
        pairs=len(exact),
        touching=int(touch.sum()),
        deep=int(deep.sum()),
        missed=share(sampled[touch] == 0),
        missed_deep=share(sampled[deep] == 0),
        spearman=float(np.asarray(spearmanr(exact[touch], sampled[touch]))[0]),
        ratio=float(np.median(sampled[deep] / exact[deep])),
        false=int(np.sum((exact == 0) & (sampled > 1e-5))),
    )


def random_pairs(count: int = 10_000, *, each: int = 8, seed: int = 0) -> Pairs:
    """Measure the depth of random pairs of overlapping colliders, exactly and by sampling.

    Two colliders of 2 to 10 cm get random orientations, and positions along a random direction such
    that their extents along it overlap by up to `OVERLAP`; their depth may be smaller.

    Args:
        count: number of pairs.
        each: number of different colliders of each kind.
        seed: seed of colliders and poses.
    """
    rng = np.random.default_rng(seed)
    # Two sets, as each MuJoCo geom has a single pose.
    objects = tuple(
        SceneObject(
            name=f"{kind}_{k}", spec=single(kind, (_shape(kind, rng), (0, 0, 0))), z=float(k)
        )
        for k, kind in enumerate(np.repeat(KINDS, 2 * each).tolist())
    )
    points = np.stack([np.asarray(surface_samples(obj, SAMPLES_OF_EACH)) for obj in objects])
    kinds = rng.integers(len(KINDS), size=(count, 2))
    pick = 2 * each * kinds + 2 * rng.integers(each, size=(count, 2)) + [0, 1]
    rot = Rotation.from_quat(rng.normal(size=(2 * count, 4))).as_matrix().reshape(count, 2, 3, 3)
    along = rng.normal(size=(count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    # Extent of each toward the other.
    towards = np.einsum("nkij,ni->nkj", rot, along) * [[[1.0], [-1.0]]]
    reach = np.max(np.einsum("nksj,nkj->nks", points[pick], towards), axis=-1).sum(axis=1)
    gap = reach - rng.uniform(0, OVERLAP, count)
    pos = np.stack([np.zeros((count, 3)), along * gap[:, None]], axis=1)
    exact = _exact(objects, pick, pos, rot)
    return Pairs(kinds, exact, _sampled(objects, points, pick, pos, rot))


def _shape(kind: str, rng: np.random.Generator) -> Shape:
    a, b, c = (float(v) for v in rng.uniform(0.01, 0.05, 3))
    if kind == "box":
        return Box(size=(2 * a, 2 * b, 2 * c))
    if kind == "sphere":
        return Sphere(radius=a)
    if kind == "capsule":
        return Capsule(radius=a / 2, length=2 * b)
    if kind == "cylinder":
        return Cylinder(radius=a, height=2 * b)
    if kind == "ellipsoid":
        return Ellipsoid(radii=(a, b, c))
    corners = rng.normal(size=(int(rng.integers(6, 16)), 3))
    corners *= np.array([a, b, c]) / np.linalg.norm(corners, axis=1, keepdims=True)
    rows = tuple((float(x), float(y), float(z)) for x, y, z in corners)
    return Mesh(vertices=rows, faces=((0, 1, 2),))


def _exact(objects: tuple[SceneObject, ...], pick: NDArray, pos: NDArray, rot: NDArray) -> NDArray:
    model, data = start_state(SceneSpec(name="pairs", objects=objects))
    geom = np.array([model.body(obj.name).geomadr[0] for obj in objects])
    geom_rotations = np.array([matrix(model.geom_quat[g]) for g in geom])
    positions = pos + np.einsum("nkij,nkj->nki", rot, model.geom_pos[geom][pick])
    rotations = rot @ geom_rotations[pick]
    distances = np.zeros(len(pick))
    for n, (a, b) in enumerate(geom[pick].tolist()):
        data.geom_xpos[[a, b]] = positions[n]
        data.geom_xmat[[a, b]] = rotations[n].reshape(2, 9)
        distances[n] = geom_distance(model, data, a, b, 1e-3)
    return np.maximum(-distances, 0.0)


def _sampled(
    objects: tuple[SceneObject, ...], points: NDArray, pick: NDArray, pos: NDArray, rot: NDArray
) -> NDArray:
    groups = []
    for group in collect_colliders(objects):
        owner, *arrays = (np.asarray(x) for x in group)
        if not len(owner):
            empty = (np.zeros((len(pick), *np.shape(x)), np.float32) for x in arrays)
            groups.append((np.zeros((len(pick), 0), np.int32), *empty))
            continue
        # Both sides of every pair have a piece of each kind; pieces of other kinds are far away.
        row = np.searchsorted(owner, pick).clip(max=len(owner) - 1)
        positions, *others = (x[row] for x in arrays)
        side = np.tile(np.array([0, 1], np.int32), (len(pick), 1))
        groups.append((side, positions + FAR * (owner[row] != pick)[..., None], *others))
    every_pair = Colliders(*(PieceGroup(*map(jnp.asarray, rows)) for rows in groups))
    unit = jnp.ones((1, 2))

    def deeper(pos: Array, rot: Array, samples: Array, colliders: Colliders) -> Array:
        return jnp.max(pair_depth_reference(pos[None], rot[None], unit, samples, colliders))

    f32 = lambda x: jnp.asarray(x, jnp.float32)
    every = jax.jit(jax.vmap(deeper))
    return np.asarray(every(f32(pos), f32(rot), f32(points[pick]), every_pair), float)

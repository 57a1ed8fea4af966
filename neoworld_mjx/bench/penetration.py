"""How well sampled penetration tells what MuJoCo measures exactly, over random pairs of colliders.

D_pen looks at a fixed number of surface points, so it misses shallow overlaps and underrates some.
"""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from neoworld_kernels import Colliders, PieceGroup, pair_depth_reference
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from scipy.spatial.transform import Rotation
from scipy.stats import spearmanr

from ..physics.colliders import collect_colliders
from ..physics.exact import geom_distance, start_state
from ..physics.sampling import surface_samples
from ..spec import Box, Capsule, Cylinder, Ellipsoid, Mesh, SceneObject, SceneSpec, Shape, Sphere
from ..spec.pose import matrix
from .scenes import single

KINDS = ("box", "sphere", "capsule", "cylinder", "ellipsoid", "polytope")
DEEP = 0.005
"""Depth [m] from which on overlaps should not be missed."""
OVERLAP = 0.03
"""Largest overlap [m] along the direction in which two colliders are pushed together."""

FAR = np.float32(1e3)
"""Where pieces are put that should touch nothing [m]."""


class Pairs(NamedTuple):
    """Random pairs of colliders; depths [m], zero where they do not touch."""

    kinds: NDArray
    """[pair, 2], indices into `KINDS`."""
    exact: NDArray
    sampled: NDArray


class AccuracyRow(BaseModel):
    """What sampling makes of the pairs of two kinds."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    first: str
    second: str
    pairs: int
    touching: int
    deep: int
    """Deeper than `DEEP`."""
    missed: float
    """Share of the touching pairs that sampling calls apart."""
    missed_deep: float
    """Share of the deep ones."""
    spearman: float
    """Rank correlation of sampled and exact depth over the touching pairs."""
    ratio: float
    """Median of sampled over exact depth of the deep pairs."""
    false: int
    """Pairs that sampling calls deeper than 10 micrometres and MuJoCo apart."""


def accuracy(pairs: Pairs) -> list[AccuracyRow]:
    """Sum up pairs by kinds; the first row, of "all", is over all of them."""
    low, high = pairs.kinds.min(axis=1), pairs.kinds.max(axis=1)
    found = [_row("all", "all", pairs, np.ones(len(low), bool))]
    for a, b in itertools.combinations_with_replacement(range(len(KINDS)), 2):
        where = (low == a) & (high == b)
        if where.any():
            found.append(_row(KINDS[a], KINDS[b], pairs, where))
    return found


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


def random_pairs(count: int = 10_000, *, samples: int = 256, each: int = 8, seed: int = 0) -> Pairs:
    """Push random colliders of all kinds into each other and measure how deep, both ways.

    Two colliders of 2 to 10 cm are turned at random and set along a random direction so that their
    extents along it overlap by up to `OVERLAP`; of how deep they then are nothing is fixed.

    Args:
        count: of pairs.
        samples: surface samples of each solid.
        each: how many different colliders of each kind there are.
        seed: of colliders and poses.
    """
    rng = np.random.default_rng(seed)
    # Two sets, one for each side: MuJoCo's geoms are in one place at a time.
    items = tuple(
        SceneObject(
            name=f"{kind}_{k}", spec=single(kind, (_shape(kind, rng), (0, 0, 0))), z=float(k)
        )
        for k, kind in enumerate(np.repeat(KINDS, 2 * each).tolist())
    )
    points = np.stack([np.asarray(surface_samples(item, samples)) for item in items])
    kinds = rng.integers(len(KINDS), size=(count, 2))
    pick = 2 * each * kinds + 2 * rng.integers(each, size=(count, 2)) + [0, 1]
    rot = Rotation.from_quat(rng.normal(size=(2 * count, 4))).as_matrix().reshape(count, 2, 3, 3)
    along = rng.normal(size=(count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    # How far each reaches towards the other.
    towards = np.einsum("nkij,ni->nkj", rot, along) * [[[1.0], [-1.0]]]
    reach = np.max(np.einsum("nksj,nkj->nks", points[pick], towards), axis=-1).sum(axis=1)
    gap = reach - rng.uniform(0, OVERLAP, count)
    pos = np.stack([np.zeros((count, 3)), along * gap[:, None]], axis=1)
    exact = _exact(items, pick, pos, rot)
    return Pairs(kinds, exact, _sampled(items, points, pick, pos, rot))


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


def _exact(items: tuple[SceneObject, ...], pick: NDArray, pos: NDArray, rot: NDArray) -> NDArray:
    model, data = start_state(SceneSpec(name="pairs", objects=items))
    geom = np.array([model.body(item.name).geomadr[0] for item in items])
    own = np.array([matrix(model.geom_quat[g]) for g in geom])
    at = pos + np.einsum("nkij,nkj->nki", rot, model.geom_pos[geom][pick])
    turned = rot @ own[pick]
    found = np.zeros(len(pick))
    for n, (a, b) in enumerate(geom[pick].tolist()):
        data.geom_xpos[[a, b]] = at[n]
        data.geom_xmat[[a, b]] = turned[n].reshape(2, 9)
        found[n] = geom_distance(model, data, a, b, 1e-3)
    return np.maximum(-found, 0.0)


def _sampled(
    items: tuple[SceneObject, ...], points: NDArray, pick: NDArray, pos: NDArray, rot: NDArray
) -> NDArray:
    found = []
    for group in collect_colliders(items):
        owner, *rest = (np.asarray(x) for x in group)
        if not len(owner):
            empty = (np.zeros((len(pick), *np.shape(x)), np.float32) for x in rest)
            found.append((np.zeros((len(pick), 0), np.int32), *empty))
            continue
        # Every pair has a piece of each kind on both sides; those of other kinds are far away.
        row = np.searchsorted(owner, pick).clip(max=len(owner) - 1)
        at, *others = (x[row] for x in rest)
        side = np.tile(np.array([0, 1], np.int32), (len(pick), 1))
        found.append((side, at + FAR * (owner[row] != pick)[..., None], *others))
    every_pair = Colliders(*(PieceGroup(*map(jnp.asarray, rows)) for rows in found))
    one = jnp.ones((1, 2))

    def deeper(pos: Array, rot: Array, samples: Array, own: Colliders) -> Array:
        return jnp.max(pair_depth_reference(pos[None], rot[None], one, samples, own))

    f32 = lambda x: jnp.asarray(x, jnp.float32)
    every = jax.jit(jax.vmap(deeper))
    return np.asarray(every(f32(pos), f32(rot), f32(points[pick]), every_pair), float)


__all__ = ["DEEP", "KINDS", "AccuracyRow", "Pairs", "accuracy", "random_pairs"]

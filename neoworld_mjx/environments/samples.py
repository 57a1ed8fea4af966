"""All the scenes that a photograph allows: draws from the estimate that stand, side by side."""

import io
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import jax
import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components

from ..config import RefineOptions
from ..errors import RunError, SpecError
from ..io.files import write_output
from ..measure import HELD, SceneCheck, SceneMeasure, rest_and_measure, resting, scene_checks
from ..physics.colliders import pair_distance
from ..physics.engine import Engine, open_engine
from ..physics.layout import Layout, Poses, Variation
from ..physics.model import SceneModel, compile_scene
from ..physics.posterior import Draws, PhysicalPrior, draw, draw_again
from ..spec import Camera, ObjectSpec, SceneObject, SceneSpec, read_scene
from .contact_draws import SceneContacts
from .placed_draws import PlacedDraws, box_shifts, moved_camera

MAX_PX = 10.0
"""Largest displacement of a side of an object's 2D box in an image 640 pixels wide; about twice the
distance of a fitted outline from the outline in the photograph."""
REDRAWS = 4
"""Number of times that a refused draw is drawn again."""
TOUCH_M = 0.005
"""Gap up to which two objects touch [m]; refused objects are drawn again with those they touch."""
VERBS = {
    "max_depth_m": "overlaps",
    "settled_depth_m": "overlaps",
    "max_drift_m": "moves",
    "max_tilt_deg": "tips",
    "max_joint_slide_m": "does not hold its joint",
    "max_joint_turn_deg": "does not hold its joint",
    "settled_away": "settles elsewhere",
}
"""What an object does that fails a check of the scene, by the name of the check."""
PER_DRAW = (
    *("drawn", "layouts", "poses", "cameras", "measures"),
    *("stands", "shift_px", "at_fault", "reasons"),
)
"""Fields of `SceneSamples` that have one value for each draw."""


@dataclass(frozen=True, repr=False)
class SceneSamples:
    """Draws about a scene, settled, and which of them stand and agree with the photograph.

    The draws come from the posterior of the estimate. Draws that do not stand or that the pixels
    exclude are drawn again, and refused in the end, so all that are kept have the same weight.
    """

    model: SceneModel
    """The compiled scene about which was drawn; `layouts` and `poses` are candidates of it."""
    seed: int
    drawn: Draws
    """The draws before contacts."""
    layouts: Layout
    poses: Poses
    """Settled poses, sizes and physical quantities of all draws."""
    cameras: tuple[Camera | None, ...]
    measures: tuple[SceneMeasure, ...]
    """Penetration, drift and displacement by settling of each draw."""
    stands: Bool[np.ndarray, " n"]
    """True for draws that pass the final check."""
    shift_px: Float[np.ndarray, "n object"]
    """Largest displacement of a side of each object's 2D box, in an image `PIXEL_WIDTH` wide; 0
    without a camera."""
    at_fault: Bool[np.ndarray, "n object"]
    """True for objects that fail a check, or leave their pixels."""
    reasons: tuple[str, ...]
    """Why each draw is refused, such as "cup tips"; empty if it is kept."""
    refused: tuple[str, ...] = ()
    """Reasons of the draws that were refused and drawn again."""

    @property
    def kept(self) -> Int[np.ndarray, " kept"]:
        """Indices of the draws that stand and that the pixels allow."""
        return np.flatnonzero([not reason for reason in self.reasons])

    @property
    def weights(self) -> Float[np.ndarray, " n"]:
        """Weight of each draw: equal for all that are kept, and 0 for the others."""
        weights = np.zeros(len(self.reasons))
        weights[self.kept] = 1.0 / max(len(self.kept), 1)
        return weights

    def __len__(self) -> int:
        return len(self.reasons)

    def __repr__(self) -> str:
        return f"SceneSamples of {self.model.spec.name!r}: {self.phrase()}"

    def phrase(self) -> str:
        """Return one line, such as "stands in 64 of 64; kept 63; refused: cup tips (1)"."""
        line = f"stands in {int(self.stands.sum())} of {len(self)}"
        if counts := Counter(reason for reason in self.reasons if reason):
            line += f"; kept {len(self.kept)}; refused: {_counted(counts)}"
        if held := [item.name for item in self.model.spec.objects if item.held]:
            line += f"; held in place: {', '.join(held)}"
        if self.refused:
            line += f"; refused and drawn again: {_counted(Counter(self.refused), 3)}"
        return line

    def scene(self, k: int) -> SceneSpec:
        """Return the scene of a draw, kept or not, with its masses, frictions and camera."""
        placed = self.model.apply(self.layouts, k, self.poses)
        varied = _with_variation(self.model, placed, self.poses, k)
        return self.model.scene_at(self.poses, k, varied).model_copy(
            update={"camera": self.cameras[k]}
        )

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """All draws as arrays, by the names in `samples.npz`."""
        v = self.poses.variation
        assert v is not None
        arrays = {
            "objects": np.array(self.model.names),
            "joints": np.array(self.model.static.joint_names, str),
            "pos": self.poses.pos,
            "quat": self.poses.quat,
            "size": self.poses.scale,
            "mass": v.mass,
            "friction": v.friction,
            "joint_friction": v.joint_friction,
            "joint_damping": v.joint_damping,
            "opening": v.opening,
            "weights": self.weights,
            "stands": self.stands,
            "shift_px": self.shift_px,
            "reasons": np.array(self.reasons, str),
            "seed": np.array(self.seed),
        }
        return {name: np.asarray(value) for name, value in arrays.items()}

    def replaced(self, rows: Int[np.ndarray, " m"], others: "SceneSamples") -> "SceneSamples":
        """Return the samples with other draws in some rows, which become refused ones."""
        index = np.arange(len(self))
        index[rows] = len(index) + np.arange(len(rows))

        def merged(name: str) -> Any:
            own, other = getattr(self, name), getattr(others, name)
            if name in ("cameras", "measures", "reasons"):
                return tuple((*own, *other)[k] for k in index)
            return jax.tree.map(lambda *leaves: np.concatenate(leaves)[index], own, other)

        refused = self.refused + tuple(self.reasons[k] for k in rows)
        return replace(self, refused=refused, **{name: merged(name) for name in PER_DRAW})

    def write(self, path: Path) -> None:
        """Write the arrays as a .npz file."""
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **self.arrays)
        write_output(path, buffer.getvalue(), RunError)


def sample(
    scene: SceneSpec | SceneModel | Path | str,
    n: int = 64,
    *,
    seed: int = 0,
    options: RefineOptions | None = None,
    prior: PhysicalPrior | None = None,
    max_px: float = MAX_PX,
    redraws: int = REDRAWS,
    sizes: bool = True,
    engine: str | Engine = "native",
) -> SceneSamples:
    """Draw scenes that a photograph allows.

    Poses, sizes and the camera are drawn from the estimate about the scene, with its
    correlations and contacts; densities, frictions, losses and openings of joints are drawn from
    priors.
    Every draw is placed on its supports, settled and checked like a refined scene, all in one
    batch. The objects that are the reason of a refusal are drawn again.

    Args:
        scene: the scene, compiled or not, a scene.json or a run folder.
        n: number of draws.
        seed: random seed.
        options: options of settling and of the final check.
        prior: priors of what no picture shows.
        max_px: a draw is refused if a side of an object's 2D box moved by more than this and 5 % of
            the diagonal of the box, in an image 640 pixels wide.
        redraws: number of times that a draw that leaves its pixels is drawn again before it is
            settled, and that a refused draw is drawn again. Only the objects that are the reason,
            and those that touch them, are drawn again.
        sizes: if False, all objects keep their sizes, and draws are not compared with the pixels,
            where an object that is farther away would have to be larger.
        engine: engine that settles the draws and lets them fall, or its name. C MuJoCo computes
            depths in any case.

    Raises:
        SpecError: there is no scene, or `n` is not positive.
        EngineError: the engine cannot run, or a draw has more contacts than MuJoCo's memory holds.
    """
    if n < 1:
        raise SpecError(f"sample: n is {n}, not a positive number of draws")
    if isinstance(scene, Path | str):
        scene = read_scene(Path(scene))
    model = compile_scene(scene, timestep=0.002) if isinstance(scene, SceneSpec) else scene
    o, rng = options or RefineOptions(), np.random.default_rng(seed)
    opened = open_engine(engine) if isinstance(engine, str) else engine
    contacts, touching = SceneContacts(model, sizes), _touching(model)
    limit, refused = max_px if sizes else math.inf, list[str]()

    def again(drawn: Draws, at_fault: Bool[np.ndarray, "n object"]) -> PlacedDraws:
        """Draw objects, and those that they touch, again."""
        fresh = draw_again(model, drawn, at_fault @ touching, rng, prior)
        return PlacedDraws.of(contacts, fresh, limit)

    def within_pixels(placed: PlacedDraws) -> PlacedDraws:
        """Draw again what leaves its pixels where it is placed: that needs no simulation."""
        for _ in range(redraws):
            rows = np.flatnonzero((placed.excess_px > 0).any(axis=1))
            refused.extend(_pixel_reason(model.names, placed.excess_px[k]) for k in rows)
            if not len(rows):
                break
            out = placed[rows]
            placed = placed.replaced(rows, again(out.drawn, out.excess_px > 0))
        return placed

    first = PlacedDraws.of(contacts, draw(model, rng, n, prior), limit)
    samples = _settled(contacts, within_pixels(first), o, limit, seed, opened)
    for _ in range(redraws):
        rows = np.flatnonzero(samples.at_fault.any(axis=1))
        if not len(rows):
            break
        drawn = jax.tree.map(lambda leaf, rows=rows: leaf[rows], samples.drawn)
        placed = within_pixels(again(drawn, samples.at_fault[rows]))
        samples = samples.replaced(rows, _settled(contacts, placed, o, limit, seed, opened))
    return replace(samples, refused=(*samples.refused, *refused))


def _settled(
    contacts: SceneContacts,
    placed: PlacedDraws,
    o: RefineOptions,
    max_px: float,
    seed: int,
    engine: Engine,
) -> SceneSamples:
    """Settle and check draws."""
    model = contacts.scene
    poses, measures = rest_and_measure(model, placed.poses, o, engine=engine, stop_early=True)
    shift, excess = box_shifts(contacts, poses, placed.camera, max_px)
    held = np.array([item.held for item in model.spec.objects])
    rests = held | np.array([resting(model.spec, measure, o) for measure in measures])
    diverged = np.array([measure.diverged for measure in measures])
    return SceneSamples(
        model=model,
        seed=seed,
        drawn=placed.drawn,
        layouts=placed.layouts,
        poses=poses,
        cameras=tuple(moved_camera(contacts.unknowns, change) for change in placed.camera),
        measures=tuple(measures),
        stands=np.array([all(c.passed for c in _checks(measure, o)) for measure in measures]),
        shift_px=shift,
        at_fault=~rests | (excess > 0) | diverged[:, None],
        reasons=tuple(
            _reason(measure, o) or _pixel_reason(model.names, row)
            for measure, row in zip(measures, excess, strict=True)
        ),
    )


def _touching(model: SceneModel) -> Bool[np.ndarray, "object object"]:
    """Return which objects are in one group: they touch, stand on each other, or others link them.

    Fixed supports link nothing.
    """
    m, data = model.static.mjm, mujoco.MjData(model.static.mjm)
    data.qpos[:] = model.static.start
    mujoco.mj_kinematics(m, data)
    geoms = [np.flatnonzero(model.static.geom_object == k) for k in range(len(model.names))]
    near = np.zeros((len(geoms), len(geoms)), bool)
    free = [k for k, item in enumerate(model.spec.objects) if not item.environment]
    for i, j in combinations(free, 2):
        near[i, j] = pair_distance(m, data, geoms[i], geoms[j], reach=TOUCH_M) < TOUCH_M
    _, group = connected_components(near, directed=False)
    return group[:, None] == group


def _counted(counts: Counter[str], most: int | None = None) -> str:
    shown = [f"{reason} ({k})" for reason, k in counts.most_common(most)]
    left = sum(counts.values()) - sum(k for _, k in counts.most_common(most))
    return ", ".join([*shown, f"others ({left})"] if left else shown)


def _reason(measure: SceneMeasure, o: RefineOptions) -> str:
    """Return the first failed check of a draw as "object verb"; empty if it passes all checks."""
    if measure.diverged:
        return "the simulation diverges"
    for check in _checks(measure, o):
        if not check.passed:
            return f"{check.where.split('|')[-1].split('-', 1)[0]} {VERBS[check.name]}"
    return ""


def _checks(measure: SceneMeasure, o: RefineOptions) -> list[SceneCheck]:
    """Return the checks of a draw. Objects that are held are held in all, so none is refused."""
    return [check for check in scene_checks(measure, o) if check.name != HELD]


def _pixel_reason(names: Sequence[str], excess: Float[np.ndarray, " object"]) -> str:
    worst = int(excess.argmax())
    return f"{names[worst]} leaves its pixels" if excess[worst] > 0 else ""


def _with_variation(model: SceneModel, scene: SceneSpec, poses: Poses, k: int) -> SceneSpec:
    """Return a scene with the physical quantities and openings of a draw."""
    assert poses.variation is not None
    one = jax.tree.map(lambda leaf: np.asarray(leaf)[k], poses.variation)
    objects = []
    for n, item in enumerate(scene.objects):
        joints = {
            name.split("-", 1)[1]: j
            for j, name in enumerate(model.static.joint_names)
            if model.static.joint_object[j] == n
        }
        spec = _varied_object(item, float(one.mass[n]), float(one.friction[n]), one, joints)
        state = dict(item.joint_state)
        for name in filter(lambda name: one.opening[joints[name]], joints):
            slides = model.static.joint_slides[joints[name]]
            size = float(np.asarray(poses.scale)[k, n]) if slides else 1.0
            state[name] = state.get(name, 0.0) + size * float(one.opening[joints[name]])
        objects.append(item.model_copy(update={"spec": spec, "joint_state": state}))
    return scene.model_copy(update={"objects": tuple(objects)})


def _varied_object(
    item: SceneObject, mass: float, friction: float, one: Variation, joints: dict[str, int]
) -> ObjectSpec:
    spec = item.spec
    materials = tuple(
        m.model_copy(update={"density": m.density * mass, "friction": m.friction * friction})
        for m in spec.materials
    )
    parts = []
    for part in spec.parts:
        update: dict[str, object] = {} if part.mass is None else {"mass": part.mass * mass}
        if part.inertia is not None:
            moments, products = (
                tuple(mass * v for v in values)
                for values in (part.inertia.moments, part.inertia.products)
            )
            update["inertia"] = part.inertia.model_copy(
                update={"moments": moments, "products": products}
            )
        parts.append(part.model_copy(update=update))
    moved = tuple(
        joint.model_copy(
            update={
                "friction": joint.friction * float(one.joint_friction[joints[joint.name]]),
                "damping": joint.damping * float(one.joint_damping[joints[joint.name]]),
            }
        )
        if joint.name in joints
        else joint
        for joint in spec.joints
    )
    return spec.model_copy(update={"materials": materials, "parts": tuple(parts), "joints": moved})

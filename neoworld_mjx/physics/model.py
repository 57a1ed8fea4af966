"""Compiled scenes. A scene is compiled once for any number of layouts."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import mujoco
import numpy as np
from jaxtyping import Bool, Float
from neoworld_kernels import sorted_samples

from ..cache import free_memory_maps
from ..errors import SpecError
from ..spec import SceneSpec, bounds, read_scene, with_layout, with_world_poses, world_poses
from ..spec.object import mass_exponent
from ..spec.pose import pose
from ..spec.scale import joint_exponents
from .colliders import collect_colliders
from .layout import Arrangement, Layout, Poses, arrange, compose_poses, diagonal, frames
from .mjcf import body_name, object_of_body, to_mjspec
from .photo_view import photo_deviations, photo_view
from .sampling import extreme_points, is_round, surface_samples
from .scene_arrays import SceneArrays, on_device, snapped_heights

BALL = int(mujoco.mjtJoint.mjJNT_BALL)
FREE = int(mujoco.mjtJoint.mjJNT_FREE)
HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)
MESH = int(mujoco.mjtGeom.mjGEOM_MESH)


class Powers(NamedTuple):
    """Exponents p of MjModel fields: an entry is proportional to s^p if its object has scale s."""

    body_mass: np.ndarray
    body_inertia: np.ndarray
    jnt_range: np.ndarray
    jnt_stiffness: np.ndarray
    jnt_actfrcrange: np.ndarray
    dof_armature: np.ndarray
    dof_damping: np.ndarray
    dof_frictionloss: np.ndarray


@dataclass(frozen=True, eq=False)
class StaticScene:
    """Static data of a scene on the host.

    Instances are hashed by identity, so they may be static arguments of `jit`.
    """

    spec: SceneSpec
    mjm: mujoco.MjModel
    arrangement: Arrangement
    """Parameters of `place`; without support surfaces if the scene is only simulated."""
    names: tuple[str, ...]
    """Object names, in the order of the object axis."""
    root: np.ndarray
    """Body of each object's root part, shape [object]."""
    body_object: np.ndarray
    """Object of each body, -1 for the world, shape [nbody]."""
    geom_object: np.ndarray
    jnt_object: np.ndarray
    dof_object: np.ndarray
    powers: Powers
    start: np.ndarray
    """qpos of the composed scene, shape [nq]."""
    corners: np.ndarray
    """Corners of each object's bounding box in its frame, at its joint state [m], shape
    [object, 8, 3]."""
    round: np.ndarray
    """True for objects that are symmetric about their frame's z axis, shape [object]."""
    movable: np.ndarray
    """True for objects whose base is free, shape [object]."""
    characteristic_length: np.ndarray
    """Factor that converts the velocity of each dof to [m/s], shape [nv]: half the diagonal of the
    object's bounding box [m] for a rotational dof, 1 for a translational dof."""
    joints: np.ndarray
    """MuJoCo's indices of all joints except free joints, shape [joint]."""
    joint_names: tuple[str, ...]
    """Names of these joints, "object-joint"."""
    joint_object: np.ndarray
    """Object of each joint, shape [joint]."""
    joint_slides: np.ndarray
    """True for sliding joints, whose shift is in m instead of rad, shape [joint]."""


class CompiledScene(eqx.Module):
    """A scene compiled for simulation only: any poses, but no placement or scoring of layouts."""

    static: StaticScene = eqx.field(static=True)

    @property
    def spec(self) -> SceneSpec:
        """The composed scene."""
        return self.static.spec

    @property
    def names(self) -> tuple[str, ...]:
        """Object names, in the order of the object axis."""
        return self.static.names

    def poses(self, scene: SceneSpec | None = None) -> Poses:
        """Return the world poses and sizes of a scene's objects as one candidate.

        They are in double precision.

        Args:
            scene: a scene with the objects of this one, at any poses and sizes. If None, it is this
                scene.
        """
        scene = self.spec if scene is None else scene
        posed = world_poses(scene).values()
        pos, quat = (np.array([getattr(p, name) for p in posed])[None] for name in ("pos", "quat"))
        extent = lambda item: np.linalg.norm(np.subtract(*bounds(item.spec, item.joint_state)))
        pairs = zip(scene.objects, self.spec.objects, strict=True)
        size = [1.0 if a.spec is b.spec else extent(a) / extent(b) for a, b in pairs]
        return Poses(pos, quat, np.array(size, float)[None], pos[..., 2])

    def scene_at(
        self,
        poses: Poses,
        k: int = 0,
        scene: SceneSpec | None = None,
        only: Bool[np.ndarray, " object"] | None = None,
    ) -> SceneSpec:
        """Return a scene whose movable objects have the world poses of a candidate.

        Args:
            poses: poses of the candidates.
            k: index of the candidate.
            scene: the scene at the candidate's sizes. If None, it is this scene.
            only: mask of the objects that get these poses; the others move with their parents.
        """
        pos, quat = (np.asarray(x)[k].astype(float) for x in (poses.pos, poses.quat))
        chosen = self.static.movable if only is None else self.static.movable & only
        ends = {self.names[n]: pose(pos[n], quat[n]) for n in np.flatnonzero(chosen)}
        return with_world_poses(self.spec if scene is None else scene, ends)


class SceneModel(SceneArrays, CompiledScene):
    """A compiled scene, valid for any number of layouts.

    Pass a scene to jitted functions as an argument: `static` is a static field, and all other
    fields are arrays. `place`, `model_fields` and the rewards of placed poses may be jitted,
    vmapped and differentiated with respect to layouts. To jit `place`, call it inside a function,
    since `jax.jit` cannot hash the bound method. A function that needs only the arrays should take
    a `SceneArrays` padded by `pad_scene`, so that it is not recompiled for every scene.
    """

    def __repr__(self) -> str:
        """Return the scene's name, size and objects in two lines."""
        pieces = sum(group.owner.shape[0] for group in self.colliders)
        return (
            f"SceneModel {self.spec.name!r}: {len(self.names)} objects, "
            f"{sum(not item.static for item in self.spec.objects)} of them movable, "
            f"{len(self.static.joints)} joints, {pieces} convex pieces, "
            f"timestep {self.static.mjm.opt.timestep:g} s\n  objects: {', '.join(self.names)}"
        )

    def place_exactly(self, layouts: Layout) -> Poses:
        """Place candidates in double precision (NumPy), at the snapped heights of `place`."""
        height = snapped_heights(self.arrangement, layouts).astype(float)
        double_layouts = jax.tree.map(lambda leaf: np.asarray(leaf, float), layouts)
        with np.errstate(invalid="ignore", over="ignore"):  # see `unplaceable`
            return compose_poses(self.static.arrangement, double_layouts, height, np)

    def apply(self, layouts: Layout, index: int, poses: Poses | None = None) -> SceneSpec:
        """Return the scene's description, with_layout as one of the candidates.

        Args:
            layouts: the candidates, padded or not.
            index: index of the candidate.
            poses: poses of the candidates from `place`. If given, their heights are used, since
                snapping a single candidate may change the last bit of single precision.
        """
        count = len(self.names)
        # NumPy, since JAX would compile the indexing for every number of objects.
        candidate = jax.tree.map(lambda leaf: np.asarray(leaf)[index : index + 1, :count], layouts)
        if poses is None:
            height = snapped_heights(self.arrangement, candidate)[0]
        else:
            height = np.asarray(poses.height)[index, :count]
        xy, yaw, log_scale = (
            np.asarray(leaf, float)[0]
            for leaf in (candidate.xy, candidate.yaw, candidate.log_scale)
        )
        return with_layout(self.spec, xy, yaw, log_scale, np.asarray(height, float))


CHECK_TIMESTEP_S = 0.002
"""Time step of the final check [s]."""


def compile_for_simulation(
    scene: SceneSpec, *, timestep: float = CHECK_TIMESTEP_S
) -> CompiledScene:
    """Compile a scene for simulation only.

    Args:
        scene: the composed scene.
        timestep: time step [s].

    Raises:
        SpecError: MuJoCo cannot compile the scene.
    """
    try:
        mjm = to_mjspec(scene, timestep=timestep).compile()
    except (ValueError, mujoco.FatalError) as error:
        raise SpecError(f"scene {scene.name} does not compile: {error}") from None
    # Otherwise MuJoCo would reset a diverged simulation to its initial state, as if it were stable.
    mjm.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    names = tuple(item.name for item in scene.objects)
    owner = object_of_body(mjm, names)
    joints = np.flatnonzero(mjm.jnt_type != FREE)
    boxes = [bounds(item.spec, item.joint_state) for item in scene.objects]
    unit = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    return CompiledScene(
        StaticScene(
            spec=scene,
            mjm=mjm,
            arrangement=frames(scene),
            names=names,
            root=np.array([mjm.body(name).id for name in names]),
            body_object=owner,
            geom_object=owner[mjm.geom_bodyid],
            jnt_object=owner[mjm.jnt_bodyid],
            dof_object=owner[mjm.dof_bodyid] if mjm.nv else np.zeros(0, int),
            powers=_powers(scene, mjm),
            characteristic_length=_characteristic_lengths(boxes, mjm, owner),
            joints=joints,
            joint_names=tuple(mjm.joint(j).name for j in joints),
            joint_object=owner[mjm.jnt_bodyid[joints]],
            joint_slides=mjm.jnt_type[joints] == SLIDE,
            start=mjm.key("start").qpos.copy() if mjm.nkey else np.zeros(0),
            corners=np.array([a + unit * (b - a) for a, b in boxes]),
            round=np.array([is_round(o) for o in scene.objects]),
            movable=np.array([not item.static for item in scene.objects]),
        )
    )


def compile_scene(
    scene: SceneSpec,
    *,
    timestep: float = 0.004,
    samples: int = 256,
    reach: float = 1 / 3,
) -> SceneModel:
    """Compile a composed scene.

    Args:
        scene: the composed scene, which is the zero layout.
        timestep: time step of rollouts [s].
        samples: number of surface samples of each object for D_pen.
        reach: largest displacement at which objects are still snapped; see `layout.arrange`.

    Raises:
        SpecError: `scene` is not a SceneSpec, or MuJoCo cannot compile it.
    """
    if not isinstance(scene, SceneSpec):
        raise SpecError(
            f"compile_scene: scene is a {type(scene).__name__}, not a SceneSpec: load_scene takes "
            "a scene.json or a run folder"
        )
    free_memory_maps()
    static = dataclasses.replace(
        compile_for_simulation(scene, timestep=timestep).static,
        arrangement=_at_composed_heights(arrange(scene, reach=reach)),
    )
    environment = np.array([item.environment for item in scene.objects])
    optimised = is_optimised(scene)
    points = np.stack([surface_samples(o, samples) for o in scene.objects])
    arrays = SceneArrays(
        arrangement=static.arrangement,
        samples=sorted_samples(points),
        outline=np.stack([extreme_points(o) for o in scene.objects]),
        round=static.round,
        colliders=collect_colliders(scene.objects),
        photo=photo_view(scene),
        optimised=optimised,
        resized=optimised & np.array([item.known is None for item in scene.objects]),
        movable=static.movable,
        deviations=_deviations(scene),
        diagonal=np.array([diagonal(item) for item in scene.objects]),
        corners=static.corners,
        pair_mask=~np.eye(len(static.names), dtype=bool) & ~(environment[:, None] & environment),
        joint_object=static.joint_object,
        joint_slides=static.joint_slides,
    )
    return SceneModel(**vars(on_device(arrays)), static=static)


def _deviations(scene: SceneSpec) -> Float[np.ndarray, "object 4"]:
    """Return `SceneArrays.deviations`."""
    axes, others = photo_deviations(scene)
    return np.concatenate([np.linalg.norm(axes, axis=2), others], axis=1)


def is_optimised(scene: SceneSpec) -> Bool[np.ndarray, " object"]:
    """Return a mask of the objects that a search may move: not supports, and not known poses."""
    return np.array([not item.environment and item.known != "pose" for item in scene.objects], bool)


def _at_composed_heights(a: Arrangement) -> Arrangement:
    """Return an arrangement whose zero layout has the composed heights.

    The gap of each snapped object becomes its composed height minus the height at which it touches
    its support. Without this, objects that rest on several objects, are tilted, or penetrate their
    support would change their heights in the zero layout.
    """
    touch = snapped_heights(a, Layout.zero(1, len(a.parent)))[0] - a.gap
    return a._replace(gap=np.where(a.snapped, a.z - touch, a.gap))


def load_scene(path: Path | str) -> SceneModel:
    """Read a scene from a scene.json or a run folder, and compile it by `compile_scene`.

    Raises:
        SpecError: the file does not exist or contains no scene.
    """
    if not isinstance(path, Path | str):
        raise SpecError(
            f"load_scene: path is a {type(path).__name__}, not a path: compile_scene takes a "
            "SceneSpec"
        )
    return compile_scene(read_scene(Path(path)))


def _characteristic_lengths(
    boxes: Sequence[tuple[np.ndarray, np.ndarray]], m: mujoco.MjModel, owner: np.ndarray
) -> np.ndarray:
    half = np.array([np.linalg.norm(high - low) / 2 for low, high in boxes])
    length = np.ones(m.nv)
    for dof in filter(lambda dof: is_rotational(m, dof), range(m.nv)):
        length[dof] = half[owner[m.dof_bodyid[dof]]]
    return length


def is_rotational(m: mujoco.MjModel, dof: int) -> bool:
    """Return whether a dof is rotational."""
    joint = m.dof_jntid[dof]
    if m.jnt_type[joint] == FREE:
        return bool(dof - m.jnt_dofadr[joint] >= 3)
    return bool(m.jnt_type[joint] != SLIDE)


def _powers(scene: SceneSpec, m: mujoco.MjModel) -> Powers:
    mass = np.zeros(m.nbody)
    by_joint: dict[str, dict[str, float]] = {}
    for item in scene.objects:
        for part in item.spec.parts:
            mass[m.body(body_name(item, part.name)).id] = mass_exponent(part)
        for joint in item.spec.joints:
            child = item.spec.part(joint.child)
            by_joint[f"{item.name}-{joint.name}"] = joint_exponents(joint, child)

    def of_joint(key: str) -> np.ndarray:
        return np.array([by_joint.get(m.joint(j).name, {}).get(key, 0.0) for j in range(m.njnt)])

    def of_dof(key: str) -> np.ndarray:
        return of_joint(key)[m.dof_jntid] if m.nv else np.zeros(0)

    return Powers(
        body_mass=mass,
        body_inertia=np.where(m.body_mass > 0, mass + 2.0, 0.0),
        jnt_range=of_joint("upper"),
        jnt_stiffness=of_joint("stiffness"),
        jnt_actfrcrange=of_joint("effort"),
        dof_armature=of_dof("armature"),
        dof_damping=of_dof("damping"),
        dof_frictionloss=of_dof("friction"),
    )

"""Images of scenes and single objects in views that frame them."""

import io
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import SpecError, choices
from ..spec import (
    Camera,
    ObjectSpec,
    SceneObject,
    SceneSpec,
    bounds,
    link_poses,
    single_object_scene,
    world_poses,
)
from .rendering import RenderedImage, render
from .view import View


def render_scene(
    scene: SceneSpec,
    camera: Camera | View | None = None,
    *,
    width: int | None = None,
    height: int | None = None,
    supersample: int = 2,
) -> RenderedImage:
    """Render a scene.

    Args:
        scene: the scene.
        camera: the camera; if None, the camera of the scene or, if the scene has none, a view that
            frames all objects except the environment.
        width: width [px]; by default the width of the camera, or 480 without one.
        height: height [px]; by default it follows from the aspect ratio of the camera, or is 2/3 of
            the width without one.
        supersample: rays per pixel along each axis, at edges only.
    """
    camera = camera or scene_view(scene, width, height)
    return render(scene, camera, width=width, height=height, supersample=supersample)


def scene_view(scene: SceneSpec, width: int | None = None, height: int | None = None) -> View:
    """Return the view of the scene's camera, or one that frames its objects; see `render_scene`."""
    if scene.camera is not None:
        return View.of(scene.camera, width, height)
    columns = width or (480 if height is None else height * 3 // 2)
    rows = height or columns * 2 // 3
    # Look from the -x side, as cameras of photographs do.
    azimuth = np.radians(215)
    return View.framing(subject_points(scene), width=columns, height=rows, azimuth=azimuth)


def render_object(
    spec: ObjectSpec,
    joint_state: Mapping[str, float] | None = None,
    camera: Camera | View | None = None,
    *,
    width: int = 480,
    height: int = 320,
    supersample: int = 2,
) -> RenderedImage:
    """Render one object on a plain floor.

    Args:
        spec: the object.
        joint_state: joint values [rad or m]; joints that are not listed are at 0.
        camera: the camera in the object's frame; if None, view the front from above and from the
            object's right side (-y).
        width: width [px].
        height: height [px].
        supersample: rays per pixel along each axis, at edges only.
    """
    obj = SceneObject(name=spec.name, spec=spec, joint_state=dict(joint_state or {}))
    if camera is None:
        points = visible_vertices(spec, obj.joint_state)
        camera = View.framing(points, width=width, height=height)
    return render(
        single_object_scene(obj), camera, width=width, height=height, supersample=supersample
    )


def visible_vertices(spec: ObjectSpec, joint_state: Mapping[str, float] | None = None) -> NDArray:
    """Return the vertices of the visible surface in the object's frame [m], shape [n, 3]."""
    return visible_surface(spec, joint_state)[0]


def visible_surface(
    spec: ObjectSpec,
    joint_state: Mapping[str, float] | None = None,
) -> tuple[NDArray, NDArray]:
    """Return the visible surface of an object.

    If an object has no visible geoms, return the corners of its bounding box and no triangles.

    Args:
        spec: the object.
        joint_state: joint values [rad or m]; joints that are not listed are at 0.

    Returns:
        Vertices in the object's frame [m], shape [n, 3], and triangles, shape [t, 3].
    """
    from trimesh.util import append_faces

    part_poses = link_poses(spec, dict(joint_state or {}))
    points: list[NDArray] = []
    triangles: list[NDArray] = []
    for part in spec.parts:
        for geom in part.geoms:
            if geom.role != "collision":
                vertices, faces = geom.shape.surface()
                points.append(part_poses[part.name].then(geom.pose()).apply(vertices))
                triangles.append(faces)
    if points:
        return append_faces(points, triangles)
    low, high = bounds(spec, dict(joint_state or {}))
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    return corners, np.zeros((0, 3), int)


def to_png(image: RenderedImage | NDArray) -> bytes:
    """Encode a rendered image's color, or an array uint8 [h, w], [h, w, 3] or [h, w, 4], as PNG.

    Equal arrays give equal bytes.
    """
    array = image.color if isinstance(image, RenderedImage) else np.asarray(image)
    if array.dtype != np.uint8:
        raise TypeError(f"a PNG needs uint8 pixels, got {array.dtype}")
    stream = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(array)).save(stream, "PNG", compress_level=6)
    return stream.getvalue()


def subject_points(scene: SceneSpec, names: Sequence[str] = ()) -> NDArray:
    """Return the visible vertices of objects in the world frame [m], shape [n, 3].

    Args:
        scene: the scene.
        names: names of the objects. If empty, use all objects except the environment or, if the
            scene has no other objects, the environment.

    Raises:
        SpecError: the scene has no object with one of the names.
    """
    known = [obj.name for obj in scene.objects]
    for name in names:
        if name not in known:
            raise SpecError(f"object {name}: {choices(name, known)}")
    chosen = [obj for obj in scene.objects if obj.name in names]
    chosen = chosen or [obj for obj in scene.objects if not obj.environment] or list(scene.objects)
    poses = world_poses(scene)
    return np.vstack(
        [poses[obj.name].apply(visible_vertices(obj.spec, obj.joint_state)) for obj in chosen]
    )


def with_open_joints(scene: SceneSpec, share: float) -> SceneSpec:
    """Return the scene with each limited joint at a fraction of its range, from 0 to the far limit.

    The far limit is the limit with the larger absolute value. Mimic joints follow their leaders.
    """
    objects = []
    for obj in scene.objects:
        state = dict(obj.joint_state)
        for joint in obj.spec.joints:
            if joint.type in ("revolute", "prismatic") and joint.mimic is None:
                far_limit = max(joint.lower, joint.upper, key=abs)
                state[joint.name] = share * far_limit
        objects.append(obj.model_copy(update={"joint_state": state}))
    return scene.model_copy(update={"objects": tuple(objects)})

"""Ground-truth scenes, built from declarations."""

import functools
import math

from pydantic import ValidationError

from neoworld_mjx.errors import SpecError
from neoworld_mjx.program.building import run
from neoworld_mjx.program.supports import support_program
from neoworld_mjx.spec import (
    Box2D,
    Box3D,
    ObjectSpec,
    SceneObject,
    SceneSpec,
    TreeNode,
    scale,
    scaled_state,
)

from ..fidelity.rendered_scenes import see
from .declaration import ObjectDeclaration, SceneDeclaration, SupportDeclaration, program_of


def truth_scene(declared: SceneDeclaration) -> SceneSpec:
    """Return the scene of a declaration, with its camera.

    Raises:
        SpecError: a program does not run, or a joint or a part is not its object's.
    """
    objects = [_support(support) for support in declared.supports]
    objects += [_object(item) for item in declared.objects]
    try:
        return SceneSpec(
            name=declared.name, objects=tuple(objects), camera=declared.camera.camera()
        )
    except ValidationError as error:
        raise SpecError(f"scene {declared.name}: {error.errors()[0]['msg']}") from None


def photographed(declared: SceneDeclaration) -> SceneSpec:
    """Return the scene of a declaration with the visible boxes, depths and occlusion flags that
    its camera sees.
    """
    return see(truth_scene(declared), finer=2)


@functools.lru_cache(maxsize=1024)
def built(text: str) -> ObjectSpec:
    """Build the object of a program's text.

    Raises:
        SpecError: the program does not run.
    """
    result = run(text)
    if result.spec is None:
        raise SpecError("; ".join(f"{s.code}: {s.message}" for s in result.signals))
    return result.spec


def _support(support: SupportDeclaration) -> SceneObject:
    node = TreeNode(
        name=support.name,
        label=support.label,
        environment=True,
        box2d=Box2D(x0=0, y0=0, x1=1, y1=1),
        box3d=Box3D(position=support.at, size=support.size),
        outline=support.outline,
        surface=support.surface,
    )
    spec = built(support_program(node, support.surface.rgb))
    spec = spec.model_copy(update={"label": support.label})
    return SceneObject(
        name=support.name,
        spec=spec,
        environment=True,
        xy=support.at[:2],
        z=support.at[2],
        yaw=math.radians(support.yaw_deg),
    )


def _object(item: ObjectDeclaration) -> SceneObject:
    try:
        spec = built(program_of(item))
    except SpecError as error:
        raise SpecError(f"object {item.name}: {error}") from None
    spec, state = scale(spec, item.scale), scaled_state(spec, dict(item.joints), item.scale)
    return SceneObject(
        name=item.name,
        spec=spec,
        parent=item.parent,
        parent_link=item.link,
        relation=item.relation,
        environment=item.environment,
        fixed_base=item.fixed,
        xy=item.at[:2],
        z=item.at[2],
        yaw=math.radians(item.yaw_deg),
        base_tilt=item.tilt,
        joint_state=state,
    )

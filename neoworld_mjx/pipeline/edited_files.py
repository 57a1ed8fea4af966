"""Files of a run that a person edited between steps, and what follows from them.

An object is built from its edited program. A size that a person wrote into a program or an object
is known: the alignment keeps it. Positions in an edited tree are the start of Step 4; where the
photograph shows an object elsewhere, the run notes it.
"""

from collections.abc import Iterator

import numpy as np

from ..compose.layout_patch import LAYOUT_PATCH
from ..config import ProgramOptions
from ..errors import ProgramError
from ..program.building import BuildResult, build
from ..run_folder import RunFolder
from ..spec import SceneSpec, SceneTree, bounds, world_poses
from .step_context import PROGRAM, SPEC, TREE, object_file, read_spec

MOVED_M, RESIZED = 0.01, 0.05
"""Distance, and relative difference of the size, from an edited tree that a note names."""


def program_edited(run: RunFolder, name: str) -> bool:
    """Return True if a person edited the program of an object."""
    return object_file(name, PROGRAM) in run.edited_by_hand(f"program/{name}")


def tree_edited(run: RunFolder) -> bool:
    """Return True if a person edited the scene tree."""
    return any(TREE in run.edited_by_hand(step) for step in ("parse", "program"))


def edited_objects(run: RunFolder, tree: SceneTree) -> frozenset[str]:
    """Return the names of the objects whose program or spec.json a person edited."""
    return frozenset(
        node.name
        for node in tree.nodes
        if {object_file(node.name, file) for file in (PROGRAM, SPEC)}
        & {
            file
            for step in ("program", "verify")
            for file in run.edited_by_hand(f"{step}/{node.name}")
        }
    )


def build_edited(run: RunFolder, name: str, options: ProgramOptions) -> BuildResult:
    """Build an object from its edited program.

    Raises:
        ProgramError: the program builds no object.
    """
    path = run.before("verify", object_file(name, PROGRAM))
    built = build(path.read_text(encoding="utf-8"), options)
    if built.spec is None:
        raise ProgramError(f"{path}, which was edited, builds no object: {built.errors}")
    return built


def note_edited_program(run: RunFolder, name: str, built: BuildResult) -> None:
    """Record in the step `verify` that an object was built from its edited program."""
    step, reason = f"verify/{name}", f"{PROGRAM} was edited"
    edited = run.edited_by_hand(f"program/{name}")
    if object_file(name, SPEC) in edited:
        spec = read_spec(run.before("verify", object_file(name, SPEC)))
        if spec != built.spec:
            reason += f", and the edited {SPEC} describes another object, which is not used"
    run.note(step, f"{name} was built again", reason)
    if not built.ok:
        run.fallback(step, f"{name} fails checks of its edited program", built.errors)


def moves_from_tree(tree: SceneTree, scene: SceneSpec) -> Iterator[tuple[str, str]]:
    """Yield a note, as a title and a text, for each object that is not where the tree states it.

    Args:
        tree: the edited tree.
        scene: the composed or aligned scene, in the frame of the tree.
    """
    poses = world_poses(scene)
    for node in tree.nodes:
        item = scene.object(node.name)
        if item.environment:
            continue
        low, high = bounds(item.spec, item.joint_state)
        expected = node.box3d.corners(node.base_tilt).mean(axis=0)
        actual = poses[node.name].apply((low + high) / 2)
        moved = float(np.linalg.norm((actual - expected)[:2]))
        ratio = float(np.prod((high - low) / np.array(node.box3d.size)) ** (1 / 3))
        if moved > MOVED_M or abs(ratio - 1) > RESIZED:
            yield (
                f"{node.name} is not where the edited {TREE} states it",
                f"the photograph moved it by {100 * moved:.1f} cm and scaled it by {ratio:.2f}; "
                f"{LAYOUT_PATCH} holds an object where it is put",
            )

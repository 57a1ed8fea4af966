"""Inputs of the step `program`, and the box sizes that this step corrects."""

from collections.abc import Mapping

from ..config import ProgramOptions
from ..errors import SpecError
from ..io import read_object
from ..parse.crops import Crop
from ..parse.support_colours import SupportColour
from ..run_folder import RunFolder
from ..spec import Box3D, SceneTree


def program_inputs(
    tree: SceneTree,
    crops: Mapping[str, Crop],
    colours: Mapping[str, SupportColour],
    options: ProgramOptions,
) -> dict[str, dict[str, object]]:
    """Return everything that determines the program of each object, by the object's name."""
    from ..program.synthesise import all_instructions

    return {
        node.name: {
            "node": node.model_dump(mode="json"),
            "crop": crops[node.name].picture.pixels,
            "options": options.model_dump(mode="json"),
            "guide": all_instructions(options),
            "colour": None if node.name not in colours else colours[node.name].rgb,
        }
        for node in tree.nodes
    }


def with_corrected_sizes(run: RunFolder, tree: SceneTree) -> SceneTree:
    """Return a tree with the sizes that Step 2 corrected."""
    nodes = []
    for node in tree.nodes:
        path = run.path / "objects" / node.name / "program.json"
        try:
            size = read_object(path, SpecError).get("size") if path.is_file() else None
            box = node.box3d if size is None else Box3D(**dict(node.box3d) | {"size": size})
        except (ValueError, TypeError, AttributeError) as error:
            raise SpecError(f"{path} contains no valid size: {error}") from None
        nodes.append(node.model_copy(update={"box3d": box}))
    return tree.model_copy(update={"nodes": tuple(nodes)})

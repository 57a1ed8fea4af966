"""What decides the programs of a run's objects, so that a run knows which of them to do again."""

from collections.abc import Mapping

from ..config import ProgramOptions
from ..parse.crops import Crop
from ..parse.support_colours import SupportColour
from ..spec import SceneTree


def program_inputs(
    tree: SceneTree,
    pictures: Mapping[str, "Crop"],
    colours: Mapping[str, "SupportColour"],
    options: ProgramOptions,
) -> dict[str, dict[str, object]]:
    """Return what decides the program of each object, by its name."""
    from ..program.synthesise import all_instructions

    return {
        node.name: {
            "node": node.model_dump(mode="json"),
            "crop": pictures[node.name].picture.pixels,
            "options": options.model_dump(mode="json"),
            "guide": all_instructions(options),
            "colour": None if node.name not in colours else colours[node.name].rgb,
        }
        for node in tree.nodes
    }

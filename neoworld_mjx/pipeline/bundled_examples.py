"""Bundled examples: photographs with recorded responses of models."""

from importlib import resources
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from ..config import read_yaml
from ..errors import PhotoError, choices

_DATA = Path(str(resources.files("neoworld_mjx") / "data"))
_FOLDERS = (_DATA / "photos", Path(str(resources.files("neoworld_mjx"))).parent / "examples")
"""Folders of the photographs, in an installed package and in a clone of the repository."""


class Responses(BaseModel):
    """Origin of the recorded responses (tape) of an example."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    by: str
    """Who or what gave the responses."""
    date: str
    """Date of the last response with new content; later ones only bind old content to new
    prompts."""
    prompts: str
    """Version of the prompts that the responses answer, as in `Tape.prompts`."""


class BundledExample(BaseModel):
    """A bundled example."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    photo: Path
    """File of the photograph."""
    shows: str
    objects: int
    """Number of objects, without supports of the environment."""
    joints: int
    """Number of movable joints."""
    responses: Responses
    licence: str
    credit: str


def bundled_examples() -> dict[str, BundledExample]:
    """Return the examples by name.

    Raises:
        PhotoError: a photograph is missing because the installation is incomplete.
    """
    table = read_yaml(_DATA / "examples.yaml", "examples")
    return {
        name: BundledExample.model_validate({**entry, "photo": _find(entry["photo"])})
        for name, entry in table.items()
    }


def photo_of(photo: Path) -> Path:
    """Return `photo` itself, or the photograph of the example with this name.

    A folder with the name of an example, such as that of its run, does not hide the example.

    Raises:
        PhotoError: neither a file nor an example has this name.
    """
    if photo.is_file() or photo.suffix or len(photo.parts) != 1:
        return photo
    examples = bundled_examples()
    if photo.name not in examples and photo.exists():
        return photo
    if photo.name not in examples:
        raise PhotoError(
            f"{photo} is neither a file nor an example: {choices(photo.name, examples)}"
        )
    return examples[photo.name].photo


def _find(name: str) -> Path:
    for folder in _FOLDERS:
        if (folder / name).is_file():
            return folder / name
    raise PhotoError(f"the photograph {name} of an example is missing: install the package again")

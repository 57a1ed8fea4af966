"""Building of programs with their patches."""

from dataclasses import dataclass, replace
from pathlib import Path

from ..config import ProgramOptions
from ..errors import SpecError
from ..io import read_untrusted_text
from ..program import build
from ..program.watch import BuiltProgram
from .patch import SUFFIX, Patch, apply, read_patch


@dataclass(frozen=True)
class PatchedProgram(BuiltProgram):
    """The result of building a program and applying the program's patch."""

    patch: Patch | None = None
    """The patch; None if the program has no patch."""
    stale: tuple[str, ...] = ()
    """Parts, joints, geoms and materials that the patch edits but the object lacks."""


def build_patched(program: Path, options: ProgramOptions) -> PatchedProgram:
    """Build the program in a file, and apply the program's patch to the object.

    Args:
        program: the file.
        options: sandbox, limits and thresholds.

    Raises:
        SpecError: the program or patch cannot be read, or the patched object is invalid.
    """
    text = read_program(program)
    built = build(text, options)
    patch = read_patch(program)
    if patch is None or built.spec is None:
        return PatchedProgram(text, built, patch=patch)
    spec, stale = apply(patch, built.spec)
    notes = (
        *(f"patch: {change}" for change in patch.changes()),
        *(f"patch: the object no longer has {edit}" for edit in stale),
    )
    patch_files = {"program" + SUFFIX: patch.to_json()}
    return PatchedProgram(text, replace(built, spec=spec), patch_files, notes, patch, stale)


def read_program(program: Path) -> str:
    """Return a program's text.

    Raises:
        SpecError: the file cannot be read or is not text.
    """
    return read_untrusted_text(program, SpecError)

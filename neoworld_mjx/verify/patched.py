"""Build a program and apply the patch that is kept beside it."""

from dataclasses import dataclass, replace
from pathlib import Path

from ..config import ProgramOptions
from ..errors import SpecError
from ..program import build
from ..program.watch import BuiltProgram
from .patch import SUFFIX, Patch, apply, read_overlay


@dataclass(frozen=True)
class PatchedProgram(BuiltProgram):
    """What a program made, with its patch."""

    patch: Patch | None = None
    """None where none is kept."""
    stale: tuple[str, ...] = ()
    """Edits that found nothing to change."""


def build_patched(program: Path, options: ProgramOptions) -> PatchedProgram:
    """Build the program in a file, and lay the patch beside it over whatever it makes now.

    Args:
        program: the file.
        options: sandbox, limits and thresholds.

    Raises:
        SpecError: program or patch cannot be read, or together they make no valid object.
    """
    text = read_program(program)
    built = build(text, options)
    patch = read_overlay(program)
    if patch is None or built.spec is None:
        return PatchedProgram(text, built, patch=patch)
    spec, stale = apply(patch, built.spec)
    notes = (
        *(f"patch: {change}" for change in patch.changes()),
        *(f"patch: {edit} is no longer there" for edit in stale),
    )
    beside = {"program" + SUFFIX: patch.to_json()}
    return PatchedProgram(text, replace(built, spec=spec), beside, notes, patch, stale)


def read_program(program: Path) -> str:
    """Return a program's text.

    Raises:
        SpecError: it cannot be read.
    """
    try:
        return program.read_text(encoding="utf-8")
    except OSError as error:
        raise SpecError(f"cannot read {program}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise SpecError(f"{program} is not a text file") from None


__all__ = ["PatchedProgram", "build_patched", "read_program"]

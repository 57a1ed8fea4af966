"""Command `examples`: bundled photographs, which need no key of a model server."""

from dataclasses import dataclass

from .base_command import Command, CommandResult
from .listing_lines import example_lines


@dataclass(frozen=True, kw_only=True)
class ExamplesCommand(Command):
    """List the bundled photographs, which `neoworld reconstruct NAME --out DIR` takes."""

    def run(self) -> CommandResult:
        """Return the name and description of each photograph."""
        from ..pipeline.bundled_examples import bundled_examples

        examples = [
            {"name": name, **example.model_dump(mode="json")}
            for name, example in bundled_examples().items()
        ]
        return {"examples": examples}

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return example_lines(result)

"""The command `examples`: photographs that come with the package and need no key."""

from dataclasses import dataclass

from .base_command import Answer, Command
from .listing_lines import example_lines


@dataclass(frozen=True, kw_only=True)
class ExamplesCommand(Command):
    """List the bundled photographs, which `neoworld reconstruct NAME --out DIR` takes."""

    def run(self) -> Answer:
        """Return name, photograph, numbers of objects and joints, licence and credit of each."""
        from ..pipeline.bundled_examples import bundled_examples

        examples = [
            {"name": name, **example.model_dump(mode="json")}
            for name, example in bundled_examples().items()
        ]
        return {"examples": examples}

    def lines(self, answer: Answer) -> list[str]:
        """Return the answer in few lines."""
        return example_lines(answer)

"""Command `template`: write an object's program from a template, by name, seed or measured box."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional, UseAppendAction

from ..errors import RunError, SpecError
from .base_command import Command, CommandResult
from .listing_lines import template_lines


@dataclass(frozen=True, kw_only=True)
class TemplateCommand(Command):
    """List the object templates, or write the program of one."""

    name: Positional[str | None] = None
    """Name of the template. Without a name, all templates are listed."""
    out: Path | None = None
    """Output file (.py) for the program; `neoworld build` builds the object."""
    seed: int | None = None
    """Seed for sampling all parameters from their ranges. Without it, parameters keep their
    defaults."""
    size: tuple[float, float, float] | None = None
    """Depth, width and height of the object [m], for example of a measured box. Each is clipped to
    the range of its parameter."""
    set: UseAppendAction[tuple[str, ...]] = ()
    """Parameter as NAME=VALUE, such as --set drawers=4; repeatable."""

    def run(self) -> CommandResult:
        """List templates, or write a program."""
        from ..io.files import write_output
        from ..templates import template, templates

        if self.name is None:
            if self.out or self.size or self.set or self.seed is not None:
                raise SpecError("template: name a template; `neoworld template` lists them")
            return {"templates": {name: template.label for name, template in templates().items()}}
        chosen = template(self.name)
        if self.seed is not None and self.seed < 0:
            raise SpecError(f"--seed: got {self.seed}, valid is 0 or more")
        values = {} if self.seed is None else chosen.draw(self.seed)
        values |= {} if self.size is None else chosen.of_box(self.size)
        for setting in self.set:
            key, equals, value = setting.partition("=")
            if not equals:
                raise SpecError(f"--set takes NAME=VALUE, such as width=0.4, got {setting!r}")
            values[key] = _number(value)
        text = chosen.program(values)
        if self.out is not None:
            write_output(self.out, text, RunError)
        written = {} if self.out is None else {"program": str(self.out)}
        parameters = {
            name: {"value": values.get(name, p.default)}
            | ({"choices": list(p.choices)} if p.choices else {"range": [p.low, p.high]})
            | ({"unit": p.unit} if p.unit else {})
            for name, p in chosen.parameters.items()
        }
        return {
            "template": chosen.name,
            "label": chosen.label,
            **written,
            "parameters": parameters,
        }

    def lines(self, result: CommandResult) -> list[str]:
        """Return a short summary of the result."""
        return template_lines(result)


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text

"""Commands of `neoworld`: dataclasses whose fields are the flags and whose `run` does the work.

To add a command, write its class and add a row to `COMMANDS`. A command's module is imported only
if the command is used, and large packages are imported inside `run`, so that `--help` is fast.
"""

import ast
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from ..benchmark import COMMAND as BENCH_COMMAND

COMMANDS: dict[str, str] = {
    "reconstruct": ".run_commands:ReconstructCommand",
    "examples": ".run_commands:ExamplesCommand",
    "refine": ".run_commands:RefineCommand",
    "check": ".object_commands:CheckCommand",
    "template": ".object_commands:TemplateCommand",
    "sample": ".policy_commands:SampleCommand",
    "train": ".policy_commands:TrainCommand",
    "evaluate": ".policy_commands:EvaluateCommand",
    "play": ".policy_commands:PlayCommand",
    "export": ".object_commands:ExportCommand",
    "preview": ".picture_commands:PreviewCommand",
    "render": ".picture_commands:RenderCommand",
    "report": ".run_commands:ReportCommand",
    "view": ".picture_commands:ViewCommand",
    "annotate": ".picture_commands:AnnotateCommand",
    "mcp": ".mcp_command:McpCommand",
    "skill": ".mcp_command:SkillCommand",
    "sweep": ".sweep_commands:SweepCommand",
    "ablate": ".sweep_commands:AblateCommand",
    "doctor": ".doctor_command:DoctorCommand",
    "bench": BENCH_COMMAND,
}
"""Location of the class of each command as "module:Class", in the order in which `--help` lists
them; a module that starts with "." is relative to this package."""


def load(name: str) -> type:
    """Import the class of a command."""
    module, kind = COMMANDS[name].split(":")
    return getattr(import_module(module, __name__), kind)


def summary(name: str) -> str:
    """Return the first paragraph of the docstring of a command's class, without importing it."""
    module, kind = COMMANDS[name].split(":")
    found = find_spec(module, __name__)
    assert found is not None and found.origin is not None
    tree = ast.parse(Path(found.origin).read_bytes())
    (command,) = (n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == kind)
    return " ".join((ast.get_docstring(command) or "").partition("\n\n")[0].split())


__all__ = ["COMMANDS", "load", "summary"]

"""The commands of `neoworld`: a dataclass each, whose fields are its flags and whose `run` does it.

To add a command, write its class and add a row to `COMMANDS`. Heavy packages are imported inside of
`run`, and a command's module only when the command is named, so that `--help` is quick.
"""

from importlib import import_module
from typing import NamedTuple


class CommandEntry(NamedTuple):
    """A row of the table."""

    location: str
    """Location of the class: "module:Class", the module relative to this package."""
    summary: str
    """What the command does: the first sentence of the class's docstring."""

    def load(self) -> type:
        """Import the class."""
        module, name = self.location.split(":")
        return getattr(import_module(module, __name__), name)


COMMANDS: dict[str, CommandEntry] = {
    "reconstruct": CommandEntry(
        ".run_commands:ReconstructCommand", "Turn a photograph into a scene that simulates."
    ),
    "examples": CommandEntry(
        ".examples_command:ExamplesCommand",
        "List the bundled photographs, which `neoworld reconstruct NAME --out DIR` takes.",
    ),
    "refine": CommandEntry(
        ".run_commands:RefineCommand",
        "Refine the composed scene of a run again, and export it; the steps before are kept.",
    ),
    "check": CommandEntry(
        ".object_commands:CheckCommand",
        "Check a scene or an object: every verdict with its number and threshold.",
    ),
    "build": CommandEntry(
        ".object_commands:BuildCommand",
        "Turn an object's program, or its URDF, MJCF or USD, into every format and pictures.",
    ),
    "template": CommandEntry(
        ".template_command:TemplateCommand",
        "List the templates of objects, or write the program of one.",
    ),
    "export": CommandEntry(
        ".export_command:ExportCommand",
        "Write a scene or an object in a format, or for a simulator, and say what is lost.",
    ),
    "render": CommandEntry(
        ".render_command:RenderCommand",
        "Take a picture of a scene or an object, from its own camera or any other; or a turntable.",
    ),
    "report": CommandEntry(
        ".run_commands:ReportCommand", "Write report.html of a run, finished or not."
    ),
    "view": CommandEntry(
        ".view_command:ViewCommand",
        "Show a scene or an object in the browser, and change it there.",
    ),
    "annotate": CommandEntry(
        ".view_command:AnnotateCommand",
        "Make a scene of a photograph by hand, with no model: boxes, labels, camera, templates.",
    ),
    "sweep": CommandEntry(
        ".sweep_commands:SweepCommand",
        "Refine scenes with every combination of some options' values and several seeds.",
    ),
    "ablate": CommandEntry(
        ".sweep_commands:AblateCommand",
        "Refine scenes with base options and named variants, and list the differences.",
    ),
    "doctor": CommandEntry(
        ".doctor_command:DoctorCommand",
        "Say what is installed here, what can run, and what each missing thing costs.",
    ),
    "bench": CommandEntry(
        "neoworld_bench.bench_commands:BenchCommand",
        "Run benchmarks of methods, engines and models, and write their data set and tables.",
    ),
}
"""Commands by name, in the order of the help."""

__all__ = ["COMMANDS", "CommandEntry"]

"""The commands of `neoworld`: a dataclass each, whose fields are its flags and whose `run` does it.

To add a command, write its class and add a row to `COMMANDS`. Heavy packages are imported inside of
`run`, so that `--help` is quick.
"""

from .base_command import Answer, Command, Runnable
from .bench_commands import BenchCommand
from .doctor_command import DoctorCommand
from .examples_command import ExamplesCommand
from .export_command import ExportCommand
from .object_commands import BuildCommand, CheckCommand
from .render_command import RenderCommand
from .run_commands import ReconstructCommand, RefineCommand, ReportCommand
from .sweep_commands import AblateCommand, SweepCommand
from .template_command import TemplateCommand
from .view_command import AnnotateCommand, ViewCommand

COMMANDS: dict[str, type] = {
    "reconstruct": ReconstructCommand,
    "examples": ExamplesCommand,
    "refine": RefineCommand,
    "check": CheckCommand,
    "build": BuildCommand,
    "template": TemplateCommand,
    "export": ExportCommand,
    "render": RenderCommand,
    "report": ReportCommand,
    "view": ViewCommand,
    "annotate": AnnotateCommand,
    "sweep": SweepCommand,
    "ablate": AblateCommand,
    "doctor": DoctorCommand,
    "bench": BenchCommand,
}
"""Commands by name, in the order of the help."""

__all__ = ["COMMANDS", "Answer", "Command", "Runnable"]

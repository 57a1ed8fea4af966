"""Commands of `neoworld`: dataclasses whose fields are the flags and whose `run` does the work.

To add a command, write its class and add a row to `COMMANDS`. A command's module is imported only
if the command is used, and large packages are imported inside `run`, so that `--help` is fast.
"""

from importlib import import_module
from typing import NamedTuple

from ..benchmark import COMMAND as BENCH_COMMAND


class CommandEntry(NamedTuple):
    """Location and summary of a command."""

    location: str
    """Location of the class as "module:Class"; a module that starts with "." is relative to this
    package."""
    summary: str
    """First paragraph of the class's docstring."""

    def load(self) -> type:
        """Import the class."""
        module, name = self.location.split(":")
        return getattr(import_module(module, __name__), name)


COMMANDS: dict[str, CommandEntry] = {
    "reconstruct": CommandEntry(
        ".run_commands:ReconstructCommand",
        "Reconstruct a simulation-ready scene from a photograph.",
    ),
    "examples": CommandEntry(
        ".run_commands:ExamplesCommand",
        "List the bundled photographs, which `neoworld reconstruct NAME --out DIR` takes.",
    ),
    "refine": CommandEntry(
        ".run_commands:RefineCommand",
        "Refine the composed scene of a run again, and export it; earlier steps are reused.",
    ),
    "check": CommandEntry(
        ".object_commands:CheckCommand",
        "Check a scene or an object, and print each check with its value and threshold.",
    ),
    "template": CommandEntry(
        ".object_commands:TemplateCommand",
        "List the object templates, or write the program of one.",
    ),
    "sample": CommandEntry(
        ".policy_commands:SampleCommand",
        "Draw scenes that a photograph allows, and count in how many of them every object rests.",
    ),
    "train": CommandEntry(
        ".policy_commands:TrainCommand",
        "Train a policy in a scene: a robot or a flying gripper that does a task.",
    ),
    "evaluate": CommandEntry(
        ".policy_commands:EvaluateCommand",
        "Run a policy in scenes that it has not seen, and count its successes.",
    ),
    "play": CommandEntry(".policy_commands:PlayCommand", "Write a video of a policy in a scene."),
    "export": CommandEntry(
        ".object_commands:ExportCommand",
        "Export a scene or an object to a format or for a simulator, and list what is lost.",
    ),
    "preview": CommandEntry(
        ".picture_commands:PreviewCommand",
        "Draw a response to the request `parse` on the photograph, and check it, before it is "
        "given.",
    ),
    "render": CommandEntry(
        ".picture_commands:RenderCommand",
        "Render a scene or an object from the scene's or another camera.",
    ),
    "report": CommandEntry(
        ".run_commands:ReportCommand", "Write report.html of a run, finished or not."
    ),
    "view": CommandEntry(
        ".picture_commands:ViewCommand",
        "Show a scene or an object in the browser, with its joints and in free fall.",
    ),
    "annotate": CommandEntry(
        ".picture_commands:AnnotateCommand",
        "Annotate a photograph by hand, without a model: boxes, labels, camera and templates.",
    ),
    "mcp": CommandEntry(
        ".mcp_command:McpCommand",
        "Let an agent that sees pictures answer a run's requests (Model Context Protocol).",
    ),
    "skill": CommandEntry(
        ".mcp_command:SkillCommand",
        "Print the skill for coding agents, or install it into a folder of skills.",
    ),
    "sweep": CommandEntry(
        ".sweep_commands:SweepCommand",
        "Refine scenes with all combinations of the values of some options, and with several "
        "seeds.",
    ),
    "ablate": CommandEntry(
        ".sweep_commands:AblateCommand",
        "Refine scenes with base options and named variants, and list the differences.",
    ),
    "doctor": CommandEntry(
        ".doctor_command:DoctorCommand",
        "List installed components, available engines, and what missing components prevent.",
    ),
    "bench": CommandEntry(
        BENCH_COMMAND,
        "Run benchmarks of methods and engines, and write their data set.",
    ),
}
"""Commands by name, in the order in which `--help` lists them."""

__all__ = ["COMMANDS", "CommandEntry"]

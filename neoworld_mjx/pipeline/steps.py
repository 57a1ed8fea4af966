"""Steps of a run. Each step reads files of the run folder, calls a package and writes files.

A step declares everything that it reads as its inputs. The run folder repeats a step if its inputs
have changed.
"""

from collections.abc import Callable

from .compose_step import compose_scene
from .object_steps import parse_photo, program_objects, verify_objects
from .scene_steps import export_files, refine_layout
from .step_context import StepContext

STEP_FUNCTIONS: dict[str, Callable[[StepContext], None]] = {
    "parse": parse_photo,
    "program": program_objects,
    "verify": verify_objects,
    "compose": compose_scene,
    "refine": refine_layout,
    "export": export_files,
}
"""Function of each step in `run_folder.STEPS`."""

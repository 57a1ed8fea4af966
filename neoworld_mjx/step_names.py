"""The names of the steps of a run, in their order. It imports nothing heavy."""

from typing import Literal, get_args

Step = Literal["parse", "program", "verify", "compose", "refine", "export"]
STEPS: tuple[Step, ...] = get_args(Step)

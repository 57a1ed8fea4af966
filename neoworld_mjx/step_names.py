"""Names of the steps of a run, in order."""

from typing import Literal, get_args

Step = Literal["parse", "program", "verify", "compose", "refine", "export"]
STEPS: tuple[Step, ...] = get_args(Step)

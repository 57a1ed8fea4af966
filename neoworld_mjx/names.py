"""Names of export formats and of the simulators that read them.

Names of the steps of a run, in order.
"""

from typing import Literal, get_args

Format = Literal["mjcf", "urdf", "usd", "usdz", "sdf", "glb"]
FORMATS: tuple[Format, ...] = get_args(Format)
Simulator = Literal[
    "mujoco", "mjx", "newton", "isaac", "drake", "gazebo", "pybullet", "sapien", "pinocchio"
]
PREFERRED_FORMATS: dict[Simulator, tuple[Format, ...]] = {
    "mujoco": ("mjcf",),
    "mjx": ("mjcf",),
    "newton": ("usd",),
    "isaac": ("usd",),
    "drake": ("mjcf",),
    "gazebo": ("sdf",),
    "pybullet": ("urdf",),
    "sapien": ("urdf",),
    "pinocchio": ("urdf",),
}
"""For each simulator, the formats that preserve most of a scene."""

Step = Literal["parse", "program", "verify", "compose", "refine", "export"]
STEPS: tuple[Step, ...] = get_args(Step)

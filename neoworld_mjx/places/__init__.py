"""Where tasks run: in this process, in processes of this machine, on Ray or on Slurm."""

from .place import Place
from .running import HERE, check_place, run_tasks

__all__ = ["HERE", "Place", "check_place", "run_tasks"]

"""Places for tasks to run: this process, processes of this machine, Ray, Slurm."""

from .place import Place
from .running import HERE, check_place, run_tasks

__all__ = ["HERE", "Place", "check_place", "run_tasks"]

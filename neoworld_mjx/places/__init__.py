"""Places where tasks run: this process, several processes on this machine, Ray or Slurm."""

from .place import Place
from .running import HERE, check_place, run_tasks

__all__ = ["HERE", "Place", "check_place", "run_tasks"]

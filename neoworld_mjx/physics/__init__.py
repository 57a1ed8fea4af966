"""Scenes as MuJoCo models, and engines that roll out populations of layouts."""

"""Scenes as MuJoCo models, and engines that roll populations of layouts out."""

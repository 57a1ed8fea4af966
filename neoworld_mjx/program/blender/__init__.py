"""Execution of programs in a confined Blender process, and conversion of scenes to objects."""

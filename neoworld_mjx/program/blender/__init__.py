"""Execution of programs in a confined Blender process, and conversion of scenes into objects."""

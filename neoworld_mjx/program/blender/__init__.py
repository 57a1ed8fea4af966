"""Execution of programs in Blender's Python, confined in a process, and their SDK objects."""

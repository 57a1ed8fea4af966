"""Programs in Blender's Python, run confined in a process of their own, as objects of the SDK."""

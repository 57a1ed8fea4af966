"""Colors and line segments of photographs, and renderings of the scene."""

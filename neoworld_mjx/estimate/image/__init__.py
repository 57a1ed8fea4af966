"""What is computed from pixels: colors, line segments, and renderings of the scene."""

"""Step 1: a photograph becomes a scene tree."""

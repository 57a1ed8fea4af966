"""Step 1: parse a photograph into a scene tree."""

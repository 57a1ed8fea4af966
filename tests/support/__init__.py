"""Scenes, objects, hostile programs and fake servers that tests and developer benchmarks share."""

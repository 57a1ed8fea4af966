"""Annotation of a photograph by a person, and the scene tree and programs that it defines."""

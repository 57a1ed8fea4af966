"""Composed scenes of five photographs, and the time of their search."""

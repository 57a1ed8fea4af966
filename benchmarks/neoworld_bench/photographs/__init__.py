"""Composed scenes of five real photographs."""

"""Rescue of disturbed scenes of meshes with known truth."""

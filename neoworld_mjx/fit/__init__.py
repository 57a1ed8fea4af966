"""Fit camera and boxes of a scene tree to the photograph's 2D boxes."""

"""Figures of the rows of methods."""

"""Rows of the normal equations, one module for each kind of evidence."""

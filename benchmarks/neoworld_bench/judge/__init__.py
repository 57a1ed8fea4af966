"""Rendered images compared with photographs, and a model as judge."""

"""Simulated errors of responses and programs, and the initial scenes with these errors."""

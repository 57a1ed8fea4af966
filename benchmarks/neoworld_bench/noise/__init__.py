"""Errors of answers and programs, and the initial scenes that they lead to."""

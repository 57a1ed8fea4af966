"""Errors of responses and programs, and the initial scenes that result from them."""

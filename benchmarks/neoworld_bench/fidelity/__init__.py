"""Forty rendered scenes with exact truth, and the error of each step on them."""

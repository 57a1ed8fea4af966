"""Forty rendered scenes with ground truth, and the error of each step on them."""

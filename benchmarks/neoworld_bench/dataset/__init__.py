"""Thirty scenes with ground truth, declared by programs and poses."""

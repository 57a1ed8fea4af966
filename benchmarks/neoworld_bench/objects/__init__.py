"""Reconstructed objects compared with ground truth: joints and surfaces."""

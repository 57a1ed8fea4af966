"""Timings and agreement of engines, and the generated scenes that they run on."""

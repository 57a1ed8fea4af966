"""Benchmarks by looking: pictures of made scenes against photographs, and a model as judge."""

"""Benchmarks for developers of the package: `python -m benchmarks SUITE`, from the root of a
clone.
"""

"""Benchmarks for airspeed velocity; the measuring itself is `neoworld_bench`."""

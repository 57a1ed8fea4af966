"""Benchmarks: how fast populations are rolled out, and whether every engine says the same.

`physics` and `kernels` time, `agreement` compares; `scenes` makes what they run on.
"""

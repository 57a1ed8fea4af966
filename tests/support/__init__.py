"""What several tests and developer benchmarks share: small scenes, known objects, hostile
programs.
"""

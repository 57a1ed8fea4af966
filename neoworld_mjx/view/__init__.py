"""A run folder, looked at."""

"""Robot-learning environments of a run folder or a scene."""

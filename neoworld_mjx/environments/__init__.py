"""Environments for robot learning, made of a run folder or a scene."""

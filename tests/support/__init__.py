"""Scenes, objects, hostile programs and fake servers that tests share."""

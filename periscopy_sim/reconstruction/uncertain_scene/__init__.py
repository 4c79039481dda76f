"""Scenes that are known to some error: what that does to a photograph, and to its image."""

"""Ambient light on the wall, in independent replicas that estimate its error."""

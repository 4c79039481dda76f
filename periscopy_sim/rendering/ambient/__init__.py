"""Ambient light on the wall, in independent replicas that tell its error."""

"""A laboratory drawn to scale, from a scene."""

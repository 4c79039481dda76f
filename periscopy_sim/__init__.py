"""Computational periscopy: from a Mitsuba scene and a photograph of a wall to the hidden image."""

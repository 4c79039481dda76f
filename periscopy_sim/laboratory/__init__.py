"""From a ruler's numbers to a scene file."""

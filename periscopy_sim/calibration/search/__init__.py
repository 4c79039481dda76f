"""From the values of a ruler to those that explain a photograph best."""

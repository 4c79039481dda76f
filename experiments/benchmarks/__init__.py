"""How fast the package is, as ratios to other libraries and to the machine's limits."""

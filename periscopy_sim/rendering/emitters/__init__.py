"""Angular emission profiles of monitors, one file for each, with its closed form."""

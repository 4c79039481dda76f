"""File formats, each decoded without letting a damaged file surprise."""

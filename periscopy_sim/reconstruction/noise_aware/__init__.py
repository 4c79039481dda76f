"""Penalized likelihood: the hidden image that explains the photograph, given its own noise."""

"""Reconstruction without P, where P or even A does not fit in memory."""

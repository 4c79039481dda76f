"""Photographs as arrays: what a camera did to them before the scene's equations hold."""

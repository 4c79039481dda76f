"""Silhouettes of occluders nobody measured, found with the hidden image, beside the true ones."""

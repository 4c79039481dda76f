"""Proof of the rendering and the solvers against independent references."""

"""Numerics that several rooms share: threads, large products, compiled loops, validation."""

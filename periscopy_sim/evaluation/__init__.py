"""Metrics, diagnostics, sweeps: how well a method or a scene does."""

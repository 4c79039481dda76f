"""Metrics, diagnostics and figures."""

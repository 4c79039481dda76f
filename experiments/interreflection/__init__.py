"""Light that bounces: what the transport matrix holds of it, and what it costs to leave it out."""

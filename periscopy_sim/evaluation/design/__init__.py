"""Which scene tells the hidden image best: the merit of scenes over their parameters."""

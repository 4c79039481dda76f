"""The learned method: its training data, its training, and where it fails."""

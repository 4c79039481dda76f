"""The search for the mask that explains a photograph best, whatever the hidden image."""

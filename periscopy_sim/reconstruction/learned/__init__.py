"""Methods that learned from rendered photographs what hidden images look like."""

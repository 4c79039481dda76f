"""A data set on disk: its layout, reading, export."""

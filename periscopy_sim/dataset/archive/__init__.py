"""A data set on disk: its Zarr layout, completion, reading, export."""

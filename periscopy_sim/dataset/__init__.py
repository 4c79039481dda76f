"""Rendered data sets: many photographs of a wall, each with its hidden image, in one Zarr archive.

`configuration` describes a data set, `samples` draws and photographs it, `make` fills an archive,
`reading` opens, checks and exports it, or hands it to PyTorch.
"""

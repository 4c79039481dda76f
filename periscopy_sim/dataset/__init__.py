"""Rendered data sets: many photographs of a wall, each with its hidden image, in one Zarr archive.

`configuration` describes a data set, `draws` everything random in it, `samples` its photographs,
and `layout` the archive; `make` fills an archive, `reading` opens and checks one.
"""

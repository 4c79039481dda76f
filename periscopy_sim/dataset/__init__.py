"""Rendered data sets: many photographs of a wall, each with its hidden image, in one Zarr archive.

`configuration` says what a data set holds, `draws` what is random in it, `geometry` what is
rendered once for many photographs, `samples` makes them, `archive` keeps them so that no crash can
spoil them, and `making` ties these together; `reading`, `torch_dataset` and `export` are for those
who use the result.
"""

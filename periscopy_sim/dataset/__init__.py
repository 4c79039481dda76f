"""Rendered data sets: many photographs of a wall, each with its hidden image, in one Zarr archive.

`configuration` says what a data set holds, `making` draws what is random in it, renders and makes
its samples, and `archive` lays them out in a store that no crash can spoil, and reads them.
"""

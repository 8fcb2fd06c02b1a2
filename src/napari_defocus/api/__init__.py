"""The public functions of pictures, stacks and dask arrays.

They check what is asked for, and are the only place that chooses: one picture in memory is worked
on as a whole, stacks and dask arrays plane by plane and tile by tile.
"""

"""The napari side: widgets, sample data, and layers in and out."""

"""From windows to pixels: the coherent map, what is in focus, and how sure it is, (14) to (18)."""

"""Arrays, axes, intensities, progress, threads and files written whole: what every room needs."""

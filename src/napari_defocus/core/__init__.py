"""Arrays, axes, settings, progress and threads: what every room stands on."""

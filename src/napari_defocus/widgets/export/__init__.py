"""From the viewer to files and scripts."""

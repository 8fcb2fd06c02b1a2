"""From results to the viewer."""

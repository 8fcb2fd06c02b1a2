"""Thin lenses: from blur to distance and back, what a camera noted, depth as a mesh."""

"""Stacks, and pictures larger than memory: the method, tile by tile."""

"""Many pictures and stacks, resumable, on several workers."""

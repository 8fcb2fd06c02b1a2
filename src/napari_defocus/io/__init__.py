"""Pictures, stacks and settings in and out of files."""

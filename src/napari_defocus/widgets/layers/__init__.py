"""From layers to arrays, and what layers of ours are."""

"""Runs: what is wanted, as frozen dataclasses that the rooms below work off; no Qt."""

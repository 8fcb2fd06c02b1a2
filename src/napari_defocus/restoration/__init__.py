"""The blur taken away, (19), and another focus given."""

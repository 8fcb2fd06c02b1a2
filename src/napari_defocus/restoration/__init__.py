"""The blur taken away, (19), by non-blind deconvolution, and another focus given."""

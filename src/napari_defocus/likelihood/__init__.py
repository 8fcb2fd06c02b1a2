"""What one window says about its blur: local spectra, noise, likelihood and maxima, (3)-(13)."""

"""What one window says about its blur: local spectra, noise, likelihood and its maxima, (3)
to (13).
"""

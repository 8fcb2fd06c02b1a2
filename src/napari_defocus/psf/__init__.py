"""Point spread functions: families indexed by one scale, measured ones, and their calibration."""

"""What the compiled loops must equal: each one's NumPy or OpenCV form, written to be read."""

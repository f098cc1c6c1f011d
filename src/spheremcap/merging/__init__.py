"""Several recordings and sensor files on one time line."""

"""Every recipe against the Cramer-Rao bound, and against what it says of itself."""

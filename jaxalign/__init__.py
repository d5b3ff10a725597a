"""Initial alignment of strapdown inertial navigation systems in JAX."""

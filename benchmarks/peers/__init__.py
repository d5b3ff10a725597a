"""Our study beside what the field does: a compiled loop over the samples, and a loop of NumPy calls."""

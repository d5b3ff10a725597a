"""The library inside larger programs: a calibration around the alignment, a trained part within it."""

"""Tuning by gradient against a genetic algorithm and grids."""

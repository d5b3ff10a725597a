"""Experiments: each a command that writes its own results."""

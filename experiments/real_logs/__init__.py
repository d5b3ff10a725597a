"""Every recipe on every real log that it applies to."""

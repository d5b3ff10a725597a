"""Xu et al. (2017): self-alignment on a swaying base, quaternion Kalman filters."""

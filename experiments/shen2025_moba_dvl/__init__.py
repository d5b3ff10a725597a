"""Shen et al. (2025): DVL-aided alignment with Mahalanobis weights."""

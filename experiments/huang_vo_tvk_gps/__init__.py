"""Huang et al.: GPS-aided alignment by filters of the K matrix."""

"""Xu et al. (2020): DVL-aided alignment with vectors reconstructed by a robust Kalman filter."""

"""Numbers of the paper."""

from __future__ import annotations

__all__ = ["GA", "TABLE_5"]

TABLE_5 = {
    # scheme: (RMS tactical, RMS navigation, largest tactical, largest navigation); "nm" in the table, "m" in the text
    1: (12.100, 0.954, 16.433, 1.396),
    2: (14.326, 1.514, 18.815, 2.018),
    3: (12.268, 1.003, 16.672, 1.460),
    4: (12.522, 1.029, 17.007, 1.497),
}
GA = {"population": 20, "crossover": 0.7, "mutation": 0.05, "threshold": 0.995}
"""Table 1 and section 4."""

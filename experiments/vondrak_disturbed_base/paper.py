"""Numbers of the paper."""

from __future__ import annotations

__all__ = ["TABLE_5"]

TABLE_5 = {
    # scheme: (RMS tactical, RMS navigation, largest tactical, largest navigation); "nm" in the table, "m" in the text
    1: (12.100, 0.954, 16.433, 1.396),
    2: (14.326, 1.514, 18.815, 2.018),
    3: (12.268, 1.003, 16.672, 1.460),
    4: (12.522, 1.029, 17.007, 1.497),
}

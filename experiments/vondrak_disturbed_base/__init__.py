"""Alignment on a disturbed base with Vondrak's filter, run again."""

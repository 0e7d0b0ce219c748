"""Seen ground: which, when, how often and how finely, from feature sets alone. NumPy only, but for GeoTIFF."""

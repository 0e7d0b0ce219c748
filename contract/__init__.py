"""What aircraft and ground agree on: geometry, feature set, wire format. Python and NumPy, no I/O, no clock."""

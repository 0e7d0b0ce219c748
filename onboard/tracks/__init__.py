"""Things that move, followed from a click: in the pictures, then over the ground. Pure logic, time comes with the data."""

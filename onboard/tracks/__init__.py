"""Things that move, followed from a click: in the pictures, then over the ground. Time comes with the data.

Public:

- `ground_steps`: `Pictures`
- `track_book`: `TrackBook`
"""

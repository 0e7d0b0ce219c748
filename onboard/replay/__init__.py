"""A recorded flight through the same pipeline as live, and a comparison of what came out.

Public:

- `comparison`: `Comparison`
- `runner`: `Events`, `Flight`, `replay`, `summary_text`
"""

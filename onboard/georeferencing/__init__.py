"""A solved window, or a known surface, to a published `FeatureSet` with its covariances.

Public:

- `budget`: `Budget`
- `click_budget`: `click_budget`
- `feature_sets`: `Origin`, `Picture`, `Placed`, `place`
- `revision`: `Revisions`
- `surface_sets`: `over_known_ground`
"""

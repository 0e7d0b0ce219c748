"""A solved window, or a known surface, to a published `FeatureSet` with its covariances.

Public:

- `feature_sets`: `Origin`, `georeference`
- `known_ground`: `over_known_ground`
"""

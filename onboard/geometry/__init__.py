"""Multiple-view geometry and ground surfaces: pure functions of arrays.

Public:

- `linalg`: `precision_beyond`, `solve_positive`, `solve_small`
- `plane_fit`: `fit_plane`
- `plane_homography`: `Pose`, `move`, `predict_homography`, `predict_pixels`
- `relative_orientation`: `relative_ransac`, `rotation_only`, `start_pair`
- `robust`: `middle`, `robust_cost`, `cauchy_weight`, `irls`
- `terrain_grid`: `Terrain`
- `triangulation`: `on_plane`, `triangulate`
"""

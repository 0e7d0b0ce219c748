"""Multiple-view geometry and ground surfaces: pure functions of arrays.

Public:

- `camera_errors`: `COUNT`, `by_states`
- `linalg`: `solve_positive`, `solve_small`
- `planar_ambiguity`: `mirrored`
- `plane_fit`: `fit_plane`
- `relative_orientation`: `ENOUGH`, `relative_ransac`, `rotation_only`, `start_pair`
- `plane_homography`: `HomographyFit`, `Pose`, `fit_homography`, `move`, `pixel_grid`, `predict_homography`,
  `predict_pixels`
- `robust`: `middle`, `robust_cost`, `cauchy_weight`, `irls`, `median_chi2`, `student_widening`,
  `OUTLIER_SIGMAS`, `IMPOSSIBLE_SIGMAS`
- `sampling`: `evenly`
- `terrain_grid`: `Terrain`
- `triangulation`: `on_plane`, `triangulate`
"""

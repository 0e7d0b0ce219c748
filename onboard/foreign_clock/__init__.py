"""A foreign camera's clock against a log's: searched over the whole flight, known to its sigma, or refused.

Public:

- `clock_search`: `REACH_S`, `Clock`, `Evidence`, `Stated`, `Unknown`, `search`
- `log_track`: `log_track`
- `motion_cost`: `MotionNoise`
- `picture_pairs`: `Pairs`, `chosen_pairs`, `measure`
- `position_steps`: `Step`, `bridging`, `intervals`, `joined`, `steps`
"""

"""Another clock on ours, live or from a log: by exchanges, or by when its stamps arrived, with a stated sigma.

Public:

- `arrivals`: `Arrivals`
- `boot_clock`: `BootClock`, `Mode`
- `timesync`: `LinkClock`, `NS_PER_S`, `SELDOM_NS`
"""

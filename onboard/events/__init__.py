"""The pipeline's input and output: event types, the protocols of sources and sinks, the clock of a session.

Public:

- `kept_pictures`: `KEPT_BYTES`, `LEAST`, `RECENT_NS`, `Grey`, `Kept`, `KeptPictures`, `Pictured`
- `pointing`: `ACCEPTED`, `NOT_ACKNOWLEDGED`, `NO_AUTOPILOT`, `NO_CIRCLE`, `ON_GROUND`, `CircleAbout`, `LookAhead`,
  `LookAt`, `Order`, `PointingEnd`
- `session_clock`: `SessionClock`
- `sink`: `Sink`
- `source`: `AircraftReport`, `Emit`, `Severity`, `Source`, `SourceStatus`, `State`, `Stop`,
  `TelemetrySource`
- `tunnel`: `Peer`, `RadioReport`, `TunnelEnd`
- `types`: `Attitude`, `Event`, `FilterStatus`, `Frame`, `GimbalAttitude`, `GpsQuality`, `Home`, `NavEvent`,
  `PositionFix`, `RangeFinder`, `Zoom`, `ZoomUnit`
- `waiting_pictures`: `WaitingPictures`
"""

"""An autopilot of recorded flights: plays their telemetry and answers as ArduPilot and PX4 do."""

"""An autopilot of recorded flights: plays their telemetry and talks back as ArduPilot and PX4 do."""

"""`open_telemetry`: a configuration's `telemetry.url` -> the source that serves it."""

from __future__ import annotations

from pathlib import Path

from contract.errors import ConfigError
from contract.mavlink_camera.component import MavlinkCamera
from onboard.config.link import check_pointers
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.source import TelemetrySource
from onboard.events.tunnel import TunnelEnd
from onboard.telemetry.mavlink_source import LiveTelemetry, PymavlinkEnd
from onboard.telemetry.nmea_source import NmeaTelemetry
from onboard.telemetry.pointing import Pointing
from onboard.telemetry.signing import read_key
from onboard.telemetry.siyi_source import SiyiGimbal, WithGimbal, siyi_address
from onboard.telemetry.tlog_playback import PlayedTelemetry
from onboard.telemetry.transports import Address


def open_telemetry(
    config: Config,
    clock: SessionClock,
    tunnel: TunnelEnd | None = None,
    camera: MavlinkCamera | None = None,
    pointing: Pointing | None = None,
) -> TelemetrySource:
    """The source of `telemetry.url`, with that of `mount.gimbal_url` if there is one; nothing is opened before it runs.

    What passes through the autopilot is `tunnel`'s; `camera` is a component next to us on its network; `pointing`
    alone commands it.

    Raises ConfigError, one line, for what can never work: an unknown kind of url, a missing log, a bad key.
    """
    check_pointers(config.link)
    source = _open_autopilot(config, clock, tunnel, camera, pointing)
    if config.mount.gimbal_url is None or config.mount.gimbal == "never":
        return source
    gimbal = SiyiGimbal(clock, siyi_address(config.mount.gimbal_url), config.telemetry.lost_after_s)
    return WithGimbal(source, gimbal)


def _open_autopilot(
    config: Config,
    clock: SessionClock,
    tunnel: TunnelEnd | None,
    camera: MavlinkCamera | None,
    pointing: Pointing | None,
) -> TelemetrySource:
    telemetry = config.telemetry
    scheme, _, rest = telemetry.url.partition(":")
    wanted = [name for name, end in (("link.mavlink", tunnel), ("mavlink_camera.enabled", camera)) if end is not None]
    if wanted and (scheme in ("tlog", "nmea") or telemetry.backend == "mavsdk"):
        raise ConfigError(
            f"{wanted[0]} needs a live autopilot and telemetry.backend 'pymavlink': what goes to the ground passes "
            "through the autopilot"
        )
    if config.link.pointers and scheme in ("tlog", "nmea"):
        raise ConfigError("link.pointers: only a live autopilot can have its camera look somewhere, set telemetry.url")
    if camera is not None and camera.component == telemetry.component:
        raise ConfigError(f"mavlink_camera.component and telemetry.component are both {camera.component}: two numbers")
    if scheme == "tlog":
        if not Path(rest).is_file():
            raise ConfigError(f"telemetry.url {telemetry.url!r}: no such file")
        return PlayedTelemetry(config, clock, Path(rest))
    if scheme == "nmea":
        return NmeaTelemetry(config, clock, Address.parse(telemetry.url, ("nmea",)))
    address = Address.parse(telemetry.url)
    key = read_key(telemetry.signing_key) if telemetry.signing_key is not None else None
    if telemetry.backend == "mavsdk":
        if key is not None:
            raise ConfigError("telemetry.signing_key: mavsdk does not sign; set telemetry.backend to 'pymavlink'")
        from onboard.telemetry.mavsdk_source import MavsdkEnd  # noqa: PLC0415  a large native library

        return LiveTelemetry(config, clock, address, lambda: MavsdkEnd(config, clock), pointing=pointing)
    return LiveTelemetry(config, clock, address, lambda: PymavlinkEnd(config, key), tunnel, camera, pointing)

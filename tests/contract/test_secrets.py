"""Texts that are shown, logged, sent or recorded: each has no secret of an address, and everything else as it was."""

import logging

import pytest

from contract.errors import ConfigError
from contract.secrets import without_secrets
from onboard.config.recorded import recorded_toml
from onboard.config.schema import parse_config, to_toml
from onboard.events.source import SourceStatus, State
from onboard.service import journal

SECRET = "hunter2"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("rtsp://anna:hunter2@10.0.0.2:554/live", "rtsp://10.0.0.2:554/live"),
        ("rtsp://hunter2@cam/live", "rtsp://cam/live"),
        ("rtsp://anna:hunter2/x@y@cam:554/live@1", None),
        ("rtsp://anna:1234@cam/live", "rtsp://cam/live"),
        ("rtsp:/anna:hunter2@cam/live", None),
        ("rtsp://cam:554/live?token=hunter2&channel=1", "rtsp://cam:554/live?token=***&channel=1"),
        ("https://cam/a?channel=1&api_key=hunter2#x", "https://cam/a?channel=1&api_key=***#x"),
        ("gst:rtspsrc location=rtsp://cam/live user-id=anna user-pw=hunter2 latency=0 ! decodebin",
         "gst:rtspsrc location=rtsp://cam/live user-id=*** user-pw=*** latency=0 ! decodebin"),
        ('gst:rtspsrc user-pw = "hunter2 and more" ! jpegdec', "gst:rtspsrc user-pw = *** ! jpegdec"),
        ("gst:srtsrc uri=srt://h:99?mode=caller&passphrase=hunter2 ! tsdemux",
         "gst:srtsrc uri=srt://h:99?mode=caller&passphrase=*** ! tsdemux"),
        ("exec:/opt/cam --password hunter2 --gain 3", "exec:/opt/cam --password *** --gain 3"),
        ("exec:/opt/cam --wifi-pass=hunter2 --gain 3", "exec:/opt/cam --wifi-pass=*** --gain 3"),
        ("exec:env CAM_TOKEN=hunter2 /opt/cam", "exec:env CAM_TOKEN=*** /opt/cam"),
        ("exec:curl -u anna:hunter2 http://cam/x", "exec:curl -u *** http://cam/x"),
        ("exec:curl -uanna:hunter2 http://cam/x", "exec:curl -u*** http://cam/x"),
        ("exec:curl -H 'X-Api-Key: hunter2' http://cam", "exec:curl -H 'X-Api-Key: ***' http://cam"),
        ("http://cam/a.cgi?loginuse=anna&loginpas=hunter2", "http://cam/a.cgi?loginuse=***&loginpas=***"),
        ("https://cam/live?jwt=hunter2", "https://cam/live?jwt=***"),
        ("rtsp://anna:1234/56@cam:554/live", "rtsp://cam:554/live"),
        ("rtsp://anna:1234/56@10.0.0.2:554/live", "rtsp://10.0.0.2:554/live"),
        ("rtsp://anna:hun ter2hunter2@cam/live", "rtsp://cam/live"),
        ("rtsp://anna:'hunter2@cam/live", "rtsp://cam/live"),
        ('rtsp://anna:a"hunter2@cam/live', "rtsp://cam/live"),
        ("srt://h:99?streamid=hunter2", "srt://h:99?streamid=***"),
        ("srt://h:99?mode=caller&streamid=#!::r=live,u=anna,s=hunter2", "srt://h:99?mode=caller&streamid=***"),
        ("rtmp://a.example/live/hunter2", "rtmp://a.example/live/***"),
        ("rtmps://a.example:443/app/x-hunter2?backup=1", "rtmps://a.example:443/app/***?backup=1"),
        ("rtsp://cam/live/hunter2KEY", "rtsp://cam/live/***"),
        ("srt://cam:9/s/hunter2hunter2hunter2", "srt://cam:9/s/***"),
        ("http://cam/x?p%61ssword=hunter2", "http://cam/x?password=***"),
        ("rtsp://anna%3Ahunter2%40cam/live", "rtsp://cam/live"),
        ("http%3A%2F%2Fanna%3Ahunter2%40cam%2Flive", "http://cam/live"),
        ("exec:curl -H 'Authorization: Bearer hunter2' http://cam", None),
        ("postgresql://anna:hunter2@host/pins", "postgresql://host/pins"),
        ('could not open "rtsp://anna:hunter2@cam/live": 401', 'could not open "rtsp://cam/live": 401'),
    ],
)  # fmt: skip
def test_a_secret_is_left_out_and_the_rest_stays(text: str, shown: str | None) -> None:
    found = without_secrets(text)
    assert SECRET not in found and "1234" not in found and "anna" not in found
    assert shown is None or found == shown
    assert without_secrets(found) == found


@pytest.mark.parametrize(
    "text",
    [
        "rtsp://10.0.0.2:554/live", "rtsp://cam:554/stream@1", "serial:/dev/serial/by-id/usb-A_B:C@0:57600",
        "udpin:0.0.0.0:14550", "tls/10.0.0.7:7447", "gst:x264enc key-int-max=30 ! fakesink",
        "link.key = 'a.pem' is not usable: text", "camera.json: unknown key 'distortion'; did you mean 'x'?",
        "rtsp://192.168.1.10:554/Streaming/Channels/101", "rtsp://cam/live/camera01", "rtsp://cam/live/ch01_sub",
        "rtmp://host/app", "srt://0.0.0.0:9000?mode=listener", "rtsp://cam/50%25/live", "file:///a%20b/c.mp4",
        "rtsp://cam:554/a/b@1", "rtsp://cam:554: refused, ask me@host/x", "rtsp://cam/live; ask a@b",
        "http://127.0.0.1:8080/flights/20261128T102030Z-uav1-0001",
        "give --key with --certificate and --ca", "replay:/data/flight one@2", "2026-11-28 10:20:30 lost at 0:10@3",
    ],
)  # fmt: skip
def test_what_is_no_secret_stays(text: str) -> None:
    assert without_secrets(text) == text


CONFIG = """
[camera]
device = "rtsp://anna:hunter2@10.0.0.2/live"
[telemetry]
url = "udpin:0.0.0.0:14550"
[link]
key = "keys/uav1/key.pem"
allowed = ["anna"]
connect = ["tls/10.0.0.7:7447"]
"""


def test_a_recorded_configuration_has_none_and_is_a_configuration() -> None:
    config = parse_config(CONFIG)
    recorded = parse_config(recorded_toml(config))
    assert recorded.camera.device == "rtsp://10.0.0.2/live"
    assert recorded.link == config.link and recorded.telemetry == config.telemetry
    assert parse_config(to_toml(config)) == config  # setup writes what it was given


def test_errors_states_and_the_journal_have_none(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    address = "rtsp://anna:hunter2@cam/live"
    assert SECRET not in str(ConfigError(f"camera.device = {address!r}: no"))
    assert SECRET not in SourceStatus(State.LOST, f"{address}: 401").detail
    for formatter in (journal._Formatter("%(message)s"), journal._JournalFormatter("%(message)s")):
        try:
            raise ValueError(address)
        except ValueError:
            record = logging.LogRecord("pointclick", logging.ERROR, "", 0, "at %s", (address,), None)
            import sys  # noqa: PLC0415

            record.exc_info = sys.exc_info()
        assert SECRET not in formatter.format(record) and "cam/live" in formatter.format(record)

"""Each kind of message in the table of topics is handled wherever messages are: link, disk, journal, cache and page."""

import re
import time
from dataclasses import fields
from pathlib import Path

import pytest
from mcap.reader import make_reader

from contract.spot import Spot, SpotReport
from contract.topics import FEATURES, PICTURE, REPORTS, SPOTS, STATUS, TOPICS, TRACKS, Topic
from contract.track import TrackReport, TrackState, Unseen
from contract.vehicle_status import VehicleStatus, encode_status
from contract.wire.codec import encode
from contract.wire.message import PAYLOADS, payload_of
from contract.wire.picture_code import cut
from contract.wire.spot_code import encode_spots
from contract.wire.track_code import encode_track
from ground.link_recorder import LinkRecorder
from ground.recording import Recording
from ground.web.journal import Journal
from ground.web.source import Views
from ground.web.watch import NEWS
from onboard.link.byte_budget import PATIENCE_S, SHARES, USES
from onboard.storage.mcap_writer import SessionRecorder
from onboard.storage.recording_queue import COUNTED, Entry, Gap, counted
from tests.contract.pictures import small_picture
from tests.contract.sets import plain_set

ROOT = Path(__file__).resolve().parents[1]
SET, VEHICLE = plain_set(5), plain_set(5).vehicle
TRACK = TrackReport(3, TrackState.FOLLOWED, Unseen(""), SET.session, 5, SET.capture_unix_ns, 9.0, 9.0, 4.0)
# A message of each kind: a new row of the table needs one here.
MESSAGES = {
    FEATURES: encode(SET),
    STATUS: encode_status(VehicleStatus(SET.capture_unix_ns / 1e9, SET.session, "ok")),
    PICTURE: cut(small_picture(5, 500, VEHICLE), with_parity=False)[0],
    TRACKS: encode_track(TRACK),
    SPOTS: encode_spots(SpotReport(SET.session, 5, SET.capture_unix_ns, True, (Spot(9.0, 9.0, 8.0, 30.0, 9.0),))),
}
ONE_EACH = pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
REPORT_EACH = pytest.mark.parametrize("topic", REPORTS, ids=lambda topic: topic.name)


@ONE_EACH
def test_each_kind_has_one_codec_that_reads_its_message_and_no_other_key(topic: Topic) -> None:
    kind = payload_of(topic.key(VEHICLE))
    assert kind is not None and kind is PAYLOADS[topic.name] and kind.topic is topic
    assert len(kind.found(topic.key(VEHICLE), MESSAGES[topic])) == 1
    assert kind.found(f"pc/{VEHICLE}/another", MESSAGES[topic]) == [] == kind.found(topic.key(VEHICLE), b"\xff\xff")
    assert len({one.encoding for one in TOPICS}) == len(TOPICS) and topic.encoding


def test_the_codecs_are_those_of_the_table() -> None:
    assert list(PAYLOADS) == [topic.name for topic in TOPICS] and set(MESSAGES) == set(TOPICS)


@REPORT_EACH
def test_each_report_has_its_share_of_the_link(topic: Topic) -> None:
    assert topic in USES and SHARES[topic] == topic.share and PATIENCE_S[topic] == topic.patience_s > 0.0


@ONE_EACH
def test_what_is_left_out_of_a_recording_is_counted_by_its_kind(topic: Topic) -> None:
    if topic.recorded is None:
        return
    assert counted(topic) in COUNTED
    gap = Entry(topic.recorded.many, 5, 0, lambda _: None).missing("why")
    both = Gap.from_json(gap.and_then(gap).to_json())
    assert str(gap) == f"1 {topic.recorded.one}" and str(both) == f"2 {topic.recorded.many}"


@REPORT_EACH
def test_each_report_is_recorded_on_board_and_read_again(tmp_path: Path, topic: Topic) -> None:
    with SessionRecorder(tmp_path / "a.mcap", VEHICLE) as file:
        file.write_set(SET)
        file.write_report(topic, SET.capture_unix_ns, MESSAGES[topic])
    kind = PAYLOADS[topic.name]
    assert Recording(tmp_path / "a.mcap").reports(kind, [VEHICLE]) == kind.read(topic.key(VEHICLE), MESSAGES[topic])


@ONE_EACH
def test_each_kind_is_kept_on_the_ground_and_read_again(tmp_path: Path, topic: Topic) -> None:
    with LinkRecorder(tmp_path / "kept") as recorder:
        recorder.take(FEATURES.key(VEHICLE), MESSAGES[FEATURES])
        recorder.take(topic.key(VEHICLE), MESSAGES[topic])
    kind = PAYLOADS[topic.name]
    session, unix_ns = kind.stamp_of(topic.key(VEHICLE), MESSAGES[topic])
    (path,) = [file for file in (tmp_path / "kept").iterdir() if f"-{session}." in file.name]
    with path.open("rb") as stream:
        found = [
            (
                channel.message_encoding,
                message.publish_time,
                message.data,
                abs(message.log_time - time.time_ns()) < 60e9,
            )
            for _, channel, message in make_reader(stream).iter_messages(topics=[topic.key(VEHICLE)])
        ]
    assert found[-1] == (topic.encoding, unix_ns, MESSAGES[topic], True)  # stamped so, and it came now
    journal = Journal(tmp_path / "kept")
    journal.begun_unix_s += 60.0
    taken = [message[:3] for _, _, messages in journal.recent(600.0) for message in messages]
    journal.close()
    assert ((topic.key(VEHICLE), topic.encoding, MESSAGES[topic]) in taken) is (topic is not STATUS)


@REPORT_EACH
def test_each_report_has_a_view_whose_news_go_to_the_page(topic: Topic) -> None:
    if topic is STATUS:  # the page has it with each vehicle's state
        return
    view = getattr(Views(), topic.name)
    before = view.version
    view.take(topic.key(VEHICLE), b"\xff\xff")
    assert view.payload is PAYLOADS[topic.name] and view.version == before == 0
    view.take(topic.key(VEHICLE), MESSAGES[topic])
    assert view.version == 1 and set(NEWS) == {field.name for field in fields(Views)}
    for file in ("types.ts", "state.ts", "main.ts"):
        text = (ROOT / "frontend/src" / file).read_text(encoding="utf-8")
        assert re.search(rf"\b{topic.name}: |\"{topic.name}\"", text), file

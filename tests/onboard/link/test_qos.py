"""The table of topics is what travels: both ends take the quality of service from it."""

import pytest
import zenoh

from contract import topics
from contract.link_config import link_config
from contract.topics import QUERY, REPORTS, Qos, Topic
from contract.vehicle_status import VehicleStatus, encode_status
from ground import client
from ground.freshness import Reply
from onboard.link.publisher import Publisher, Rate
from tests.contract.pictures import small_picture
from tests.contract.sets import plain_set
from tests.onboard.link.asking import answered
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually

OTHER = Qos("RELIABLE", "BLOCK", "DATA_HIGH", express=False)


def of(sample: zenoh.Sample) -> tuple[str, str, bool]:
    return str(sample.congestion_control), str(sample.priority), sample.express


def expected(qos: Qos) -> tuple[str, str, bool]:
    control, priority = zenoh.CongestionControl, zenoh.Priority
    return str(getattr(control, qos.congestion_control)), str(getattr(priority, qos.priority)), qos.express


@pytest.mark.parametrize("changed", [False, True])
@pytest.mark.parametrize("topic", topics.TOPICS, ids=lambda topic: topic.name)
def test_what_is_published_has_the_quality_of_the_table(
    monkeypatch: pytest.MonkeyPatch, topic: Topic, changed: bool
) -> None:
    if changed:
        monkeypatch.setitem(vars(topic), "qos", OTHER)
    endpoint = free_endpoint()
    received: list[zenoh.Sample] = []
    config = zenoh.Config.from_json5(link_config("client", connect=[endpoint]))
    with Publisher("uav-1", [endpoint], rate=Rate(max_bit_rate=1e6)) as flying, zenoh.open(config) as ground:
        ground.declare_subscriber(topic.key("uav-1"), received.append)

        def is_received() -> bool:
            flying.publish(plain_set(10))
            flying.publish_status(encode_status(VehicleStatus(1.7e9, 7, "ok")), b"{}")
            for report in REPORTS:
                flying.report(report, b"a report")
            if room := flying.picture_room():
                flying.send_picture(small_picture(), room)
            return bool(received)

        assert eventually(is_received)
        qos = OTHER if changed else topic.qos
        assert of(received[0]) == expected(qos)
        assert str(flying._publishers[topic].reliability) == str(getattr(zenoh.Reliability, qos.reliability))


@pytest.mark.parametrize("qos", [QUERY, Qos("RELIABLE", "DROP", "DATA_LOW", express=False)])
def test_an_answer_has_the_quality_of_the_query(monkeypatch: pytest.MonkeyPatch, qos: Qos) -> None:
    received: list[zenoh.Sample] = []
    read = client._answered

    def listen(sample: zenoh.Sample) -> Reply:
        received.append(sample)
        return read(sample)

    monkeypatch.setattr(client, "QUERY", qos)
    monkeypatch.setattr(client, "_answered", listen)
    endpoint = free_endpoint()
    with Publisher("uav-1", [endpoint]) as flying:
        flying.publish(plain_set(10))
        assert "uav-1" in answered(lambda: client.inquire(endpoint))
    assert {of(sample)[:2] for sample in received} == {expected(qos)[:2]}

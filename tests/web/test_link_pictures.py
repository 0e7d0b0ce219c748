"""Pictures that cross the link, on the page: live and from `pc-ground record`; and pins shared by servers."""

import json
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from contract.feature_set import FeatureSet
from contract.picture import ImageFormat, LinkPicture
from contract.wire.codec import encode
from contract.wire.picture_code import cut
from ground.link_recorder import LinkRecorder
from ground.pins.store import PinStore
from ground.web.live import LiveSource
from ground.web.recorded import RecordedSource
from onboard.link.publisher import Publisher, Rate
from tests.onboard.link.ports import free_endpoint
from tests.web.browsing import Operator
from tests.web.served import Server, Simulated
from tests.web.test_live import wait_for

pytestmark = pytest.mark.xdist_group("web: a flight in motion")


def sets_and_picture(simulated: Simulated) -> tuple[list[FeatureSet], LinkPicture]:
    """The last sets that answer, and the second of them's picture as it would cross the link."""
    sets = [
        s
        for f in simulated.frames[-7:-1]
        if (s := simulated.recording.by_frame(simulated.vehicle, f)) is not None and s.is_ok
    ]
    second = sets[1]
    held = RecordedSource(simulated.path)
    image = held.picture(simulated.vehicle, second.session, second.frame)
    assert image is not None
    assert image.media_type == "image/jpeg"
    who = second.vehicle, second.session, second.frame, second.capture_unix_ns
    return sets, LinkPicture(*who, *second.camera.size_px, ImageFormat.JPEG, image.content)


class Aircraft:
    """Sends its sets until they are received, and then a picture of one of them."""

    def __init__(self, simulated: Simulated) -> None:
        self.sets, self.picture = sets_and_picture(simulated)
        self.endpoint = free_endpoint()
        self.publisher = Publisher(simulated.vehicle, listen=[self.endpoint], rate=Rate(20e6, 1.0, 30.0))

    def say(self, *sets: FeatureSet) -> None:
        for s in sets or self.sets:
            self.publisher.publish(s)
            time.sleep(0.05)  # the link takes the newest of those that wait

    def send_picture(self, ground: LiveSource) -> None:
        """Until a ground has it: a busy machine's link may drop a piece."""

        def is_there() -> bool:
            room = self.publisher.picture_room()
            if room > 0:
                self.publisher.send_picture(self.picture, room)
            return ground.picture(self.picture.vehicle, None, self.picture.frame) is not None

        wait_for(is_there, "the picture")


def test_a_picture_of_the_link_is_its_frames_and_says_so_late_as_it_may_come(simulated: Simulated) -> None:
    craft = Aircraft(simulated)
    source = LiveSource([craft.endpoint])
    try:
        wanted = {s.frame for s in craft.sets}

        def received_all() -> bool:
            craft.say(
                *(s for s in craft.sets if s.frame in wanted - {r.frame for r in source.frames(simulated.vehicle)})
            )
            return {row.frame for row in source.frames(simulated.vehicle)} == wanted

        wait_for(received_all, "all sets")
        assert not any(row.has_picture for row in source.frames(simulated.vehicle))
        assert source.picture(simulated.vehicle, None, craft.picture.frame) is None
        version = source.version(simulated.vehicle)
        craft.send_picture(source)
        wait_for(lambda: source.version(simulated.vehicle) > version, "the news of it")
        # So many of the newest rows are said to be new that the picture's is among them.
        news = source.frames(simulated.vehicle, source.version(simulated.vehicle) - version)
        assert [row.frame for row in news if row.has_picture] == [craft.picture.frame]
        got = source.picture(simulated.vehicle, craft.picture.session, craft.picture.frame)
        assert got is not None
        assert (got.content, got.media_type) == (craft.picture.content, "image/jpeg")
        assert source.picture(simulated.vehicle, craft.picture.session + 1, craft.picture.frame) is None
        assert source.damage() == []
    finally:
        source.close()
        craft.publisher.close()


def test_pictures_that_pc_ground_record_kept_are_in_the_list(simulated: Simulated, tmp_path: Path) -> None:
    sets, picture = sets_and_picture(simulated)
    with LinkRecorder(tmp_path) as recorder:
        for s in sets:
            recorder.take(f"pc/{s.vehicle}/features", encode(s))
        for piece in cut(picture, with_parity=True)[1:]:  # the first was lost
            recorder.take(f"pc/{picture.vehicle}/picture", piece)
    source = RecordedSource(tmp_path)
    with_picture = [row.frame for row in source.frames(simulated.vehicle) if row.has_picture]
    assert with_picture == [picture.frame]
    got = source.picture(simulated.vehicle, None, picture.frame)
    assert got is not None
    assert got.content == picture.content
    assert source.picture(simulated.vehicle, None, sets[0].frame) is None


def test_the_page_shows_the_newest_picture_that_came_and_clicks_it_as_itself(
    simulated: Simulated, chromium: Any, tmp_path: Path
) -> None:
    craft = Aircraft(simulated)
    server = Server("--connect", craft.endpoint, "--pins", tmp_path / "pins.sqlite")
    operator = None
    try:
        wanted = {s.frame for s in craft.sets[1:]}

        def rows() -> list[dict[str, Any]]:
            try:
                with urllib.request.urlopen(f"{server.local}api/vehicles/{simulated.vehicle}/frames") as reported:
                    return list(json.load(reported))
            except urllib.error.HTTPError:  # it does not know of the aircraft
                return []

        def has_sets() -> bool:
            craft.say()
            return wanted <= {row["frame"] for row in rows()}

        def has_picture() -> bool:
            if (room := craft.publisher.picture_room()) > 0:
                craft.publisher.send_picture(craft.picture, room)
            return any(row["frame"] == craft.picture.frame and row["has_picture"] for row in rows())

        wait_for(has_sets, "the sets")
        wait_for(has_picture, "the picture")
        operator = Operator(chromium, server, has_map=False)
        operator.wait_for_frame(craft.picture.frame)
        operator.page.wait_for_function(
            "() => performance.getEntriesByType('resource').some(entry => entry.name.includes('/picture'))"
        )
        operator.click(330.0, 220.0)
        assert operator.newest_pin()["clicks"][0]["frame"] == craft.picture.frame
        # What has no picture can still be looked at, and is rendered of its features.
        operator.by("step-forward").click()
        operator.wait_for_frame(craft.sets[2].frame)
        operator.check()
    finally:
        if operator is not None:
            operator.context.close()
        server.close()
        craft.publisher.close()


@pytest.mark.long  # short: tests/ground/pins/test_sharing.py
def test_two_servers_share_pins_and_say_so(serve: Callable[..., Server], chromium: Any, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    first = serve("--share-listen", endpoint, pins="first.sqlite")
    second = serve("--share-connect", endpoint, pins="second.sqlite")
    anna = Operator(chromium, first, has_map=False)
    bert = Operator(chromium, second, has_map=False)
    try:
        anna.click(300.0, 200.0)
        bert.wait_for_pins(1)
        assert bert.newest_pin()["place"]["lat_deg"] == anna.newest_pin()["place"]["lat_deg"]
        words = "1 other servers, 1 with the same"
        bert.page.wait_for_function(
            "words => document.querySelector('[data-testid=notes]').textContent.includes(words)", arg=words
        )
        anna.check()
        bert.check()
    finally:
        anna.context.close()
        bert.context.close()
    first.close()
    second.close()
    with PinStore(tmp_path / "second.sqlite") as store:
        assert len(store.pins()) == 1


@pytest.mark.long
def test_an_endpoint_in_use_is_one_line(serve: Callable[..., Server]) -> None:
    endpoint = free_endpoint()
    serve("--share-listen", endpoint, pins="first.sqlite")
    with pytest.raises(AssertionError, match=r"did not start: pc-ground: .*") as failed:
        serve("--share-listen", endpoint, pins="second.sqlite")
    assert len(str(failed.value).strip().splitlines()) == 1

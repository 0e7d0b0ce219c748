"""The live camera's loss, return and refusal, on a fake device. The same on real drivers: tests/bench/inside."""

import errno
from collections.abc import Callable
from dataclasses import replace

import pytest

from contract.camera import Camera
from contract.errors import ConfigError
from onboard.camera import v4l2_structures as v4l2
from onboard.camera.camera_health import patience_s
from onboard.camera.discovery import Identity
from onboard.camera.format_negotiation import choose_format
from onboard.camera.v4l2_camera import V4l2Camera
from onboard.camera.v4l2_device import Sizes
from onboard.config.schema import CameraConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import SourceStatus, State
from tests.onboard.camera.fake_camera import PERIOD_NS, SIZE_PX, Plugged, World, picture

OURS = Identity("uvcvideo", "Cam", "usb-1", frozenset({"/dev/v4l/by-id/usb-Cam_123-video-index0"}), "0")
CLOCK = SessionClock(1_700_000_000_000_000_000)


def live(world: World, **keys: object) -> V4l2Camera:
    config = CameraConfig.model_validate({"device": "/dev/video0", **keys})
    return V4l2Camera(
        config,
        Camera.from_field_of_view(*SIZE_PX, 60.0),
        CLOCK,
        open_device=world.open,
        now_ns=lambda: world.now_ns,
        paths=world.paths,
        identify=lambda path, device: world.sockets[path].identity,
    )


def run(camera: V4l2Camera, world: World, ends_s: float = 5.0) -> dict[float, SourceStatus]:
    """Run until `ends_s`; returns the health every 50 ms."""
    seen: dict[float, SourceStatus] = {}

    def look() -> None:
        seen[round(world.at_s, 2)] = camera.health()
        world.events.append((world.at_s + 0.05, look))

    world.ends_s = ends_s
    world.events.append((0.0, look))
    camera.run(world.emit, world)
    assert world.open_devices == 0
    return seen


def at(seen: dict[float, SourceStatus], at_s: float) -> SourceStatus:
    return seen[max(known_s for known_s in seen if known_s <= at_s)]


def first(seen: dict[float, SourceStatus], state: State, after_s: float) -> float:
    """Seconds from `after_s` to the first time the camera is in a state."""
    times = [at_s for at_s, health in seen.items() if at_s >= after_s and health.state is state]
    assert times, (state, {h.state for h in seen.values()})
    return min(times) - after_s


def test_stamps_are_the_drivers_on_the_sessions_clock_less_the_latency() -> None:
    world = World(video0=Plugged(OURS))
    seen = run(live(world, latency_s=0.02), world, 1.0)
    assert at(seen, 0.9).state is State.OK
    assert len(world.frames) == pytest.approx(30, abs=1)
    for number, (arrival_ns, frame) in enumerate(world.emitted):
        assert frame.index == number
        due_ns = world.begun_ns + (number + 1) * PERIOD_NS
        assert frame.stamp_ns == due_ns - 2_000_000 + CLOCK.offset_ns - 20_000_000
        assert arrival_ns == due_ns + CLOCK.offset_ns
        assert frame.image.shape == (48, 64)


@pytest.mark.parametrize(
    ("flags", "age_ns", "has_image", "words"),
    [
        (v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC, 0, True, "GREY, stamped at its end"),
        (v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC | v4l2.BUF_FLAG_TSTAMP_SRC_SOE, 0, True, "GREY, stamped at its start"),
        (v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC | v4l2.BUF_FLAG_ERROR, 0, False, "pictures are damaged"),
        (v4l2.BUF_FLAG_TIMESTAMP_UNKNOWN, -(10**17), True, "not of CLOCK_MONOTONIC"),
        (v4l2.BUF_FLAG_TIMESTAMP_COPY, -(10**17), True, "not of CLOCK_MONOTONIC"),
        (v4l2.BUF_FLAG_TIMESTAMP_COPY, 2_000_000, True, "GREY, stamped at its end"),
    ],
)
def test_the_drivers_flags_state_what_its_stamps_and_pictures_are(
    flags: int, age_ns: int, has_image: bool, words: str
) -> None:
    world = World(video0=Plugged(OURS, flags=flags, age_ns=age_ns))
    assert words in at(run(live(world), world, 1.0), 0.9).detail
    assert world.frames and all((frame.image is not None) == has_image for frame in world.frames)


def gone(world: World) -> None:
    del world.sockets["/dev/video0"]


def fails(number: int) -> Callable[[World], None]:
    def fault(world: World) -> None:
        world.sockets["/dev/video0"].fault = number
        world.sockets["/dev/video0"].open_fault = number

    return fault


def silent(world: World) -> None:
    world.sockets["/dev/video0"].is_silent = True


@pytest.mark.parametrize("fault", [gone, fails(errno.EIO), fails(errno.ENODEV), silent])
def test_a_camera_that_goes_is_lost_within_two_seconds_and_comes_back_by_itself(fault: Callable[[World], None]) -> None:
    ours = Plugged(OURS)
    world = World(video0=ours)

    def back() -> None:
        ours.is_silent, ours.open_fault, ours.fault = False, 0, 0
        world.sockets["/dev/video0"] = ours

    world.events = [(1.0, lambda: fault(world)), (6.0, back)]
    camera = live(world)
    seen = run(camera, world, 9.0)
    assert first(seen, State.LOST, 1.0) < 2.0
    assert all(health.state is State.LOST and health.detail for at_s, health in seen.items() if 3.1 < at_s < 5.9)
    assert first(seen, State.OK, 6.0) < 1.0
    assert camera.health().figures["reopened"] >= 1
    assert world.frames[-1].stamp_ns > CLOCK.from_monotonic_ns(world.begun_ns) + 8_500_000_000
    assert [frame.index for frame in world.frames] == list(range(len(world.frames)))


def test_a_camera_is_found_under_another_number() -> None:
    world = World(video0=Plugged(OURS), video1=Plugged(replace(OURS, card="Other", bus_info="usb-2")))
    world.events = [(1.0, lambda: world.move("video0", "video3"))]
    seen = run(live(world), world, 3.0)
    assert at(seen, 2.9).state is State.OK
    assert at(seen, 2.9).detail.startswith("/dev/video3:")


def test_another_camera_that_took_our_number_is_not_taken_for_ours() -> None:
    world = World(video0=Plugged(OURS))
    other = Plugged(Identity("uvcvideo", "Other", "usb-7", frozenset(), "0"))

    def swap() -> None:
        world.move("video0", "video1")
        world.sockets["/dev/video0"] = other

    world.events = [(1.0, swap)]
    seen = run(live(world), world, 3.0)
    assert at(seen, 2.9).detail.startswith("/dev/video1:")


def test_a_twin_that_was_there_from_the_start_is_never_ours() -> None:
    ours, twin = replace(OURS, names=frozenset()), replace(OURS, names=frozenset(), bus_info="usb-2")
    world = World(video0=Plugged(ours), video1=Plugged(twin))
    world.events = [(1.0, lambda: gone(world))]
    seen = run(live(world), world, 4.0)
    assert at(seen, 3.9).state is State.LOST
    emitted_by = world.begun_ns + 1_100_000_000
    assert world.frames[-1].stamp_ns < CLOCK.from_monotonic_ns(emitted_by)


@pytest.mark.parametrize(("sockets", "state", "words"), [((2,), State.OK, ""), ((2, 3), State.LOST, "none surely")])
def test_the_same_camera_in_another_socket_is_known_by_its_make_if_it_is_the_only_one(
    sockets: tuple[int, ...], state: State, words: str
) -> None:
    world = World(video0=Plugged(replace(OURS, names=frozenset())))

    def replug() -> None:
        for number in sockets:
            alike = replace(OURS, names=frozenset(), bus_info=f"usb-9.{number}")
            world.sockets[f"/dev/video{number}"] = Plugged(alike)

    world.events = [(1.0, lambda: gone(world)), (1.1, replug)]
    seen = run(live(world), world, 4.0)
    assert at(seen, 3.9).state is state and words in at(seen, 3.9).detail


def test_what_the_device_offers_is_in_the_refusal() -> None:
    world = World(video0=Plugged(OURS, formats={"YUYV": Sizes(((320, 240),)), "H264": Sizes(((64, 48),))}))
    with pytest.raises(ConfigError, match=r"/dev/video0: no 64x48 .* in YUYV; it offers YUYV 320x240; H264 64x48$"):
        run(live(world), world)
    assert world.open_devices == 0
    with pytest.raises(ConfigError, match=r"no MJPG in what it offers: YUYV 320x240; H264 64x48$"):
        run(live(world, format="MJPG"), world)


def test_after_the_first_opening_no_refusal_ends_the_source() -> None:
    ours = Plugged(OURS)
    world = World(video0=ours)
    world.events = [
        (1.0, lambda: setattr(ours, "formats", {"H264": Sizes()})),
        (1.0, lambda: setattr(ours, "fault", errno.EIO)),
        (3.0, lambda: setattr(ours, "formats", {"GREY": Sizes((SIZE_PX,))})),
    ]
    seen = run(live(world), world)
    assert at(seen, 2.9).state is State.LOST and "H264" in at(seen, 2.9).detail
    assert at(seen, 4.5).state is State.OK


def test_auto_prefers_the_format_that_reaches_the_rate() -> None:
    formats = {"MJPG": Sizes((SIZE_PX,)), "YUYV": Sizes((SIZE_PX,)), "NV12": Sizes(((320, 240),))}

    def chosen(**rates_hz: list[float]) -> str:
        device = World(video0=Plugged(OURS, formats=formats, rates_hz=rates_hz)).open("/dev/video0")
        return choose_format(device, "/dev/video0", SIZE_PX, "auto", 30.0).fourcc

    assert chosen(YUYV=[10.0, 5.0], MJPG=[30.0]) == "MJPG"
    assert chosen(YUYV=[29.97], MJPG=[60.0]) == "YUYV"
    assert chosen(YUYV=[10.0], MJPG=[5.0]) == "YUYV"
    assert chosen() == "YUYV"


@pytest.mark.parametrize(("fault", "words"), [(errno.EBUSY, "another program"), (errno.EACCES, "group 'video'")])
def test_why_a_camera_cannot_be_opened_is_reported(fault: int, words: str) -> None:
    world = World(video0=Plugged(OURS, open_fault=fault))
    seen = run(live(world), world, 3.0)
    assert at(seen, 0.5).state is State.STARTING
    assert at(seen, 2.9).state is State.LOST and words in at(seen, 2.9).detail


def test_a_camera_that_comes_late_is_waited_for() -> None:
    world = World()
    world.events = [(3.0, lambda: world.sockets.update({"/dev/video0": Plugged(OURS)}))]
    seen = run(live(world), world)
    assert at(seen, 2.9).state is State.LOST and "not there" in at(seen, 2.9).detail
    assert at(seen, 4.5).state is State.OK


def test_a_frozen_camera_says_so_and_hands_out_no_old_picture() -> None:
    ours = Plugged(OURS)
    world = World(video0=ours)
    world.events = [(1.0, lambda: setattr(ours, "is_frozen", True)), (3.0, lambda: setattr(ours, "is_frozen", False))]
    seen = run(live(world), world)
    assert 1.0 <= first(seen, State.FROZEN, 1.0) < 1.2
    assert first(seen, State.OK, 3.0) < 0.2
    begun_ns = CLOCK.from_monotonic_ns(world.begun_ns)
    frozen = [f for f in world.frames if 1_040_000_000 < f.stamp_ns - begun_ns < 2_950_000_000]
    assert len(frozen) > 50
    assert all(frame.image is None for frame in frozen)
    assert all(frame.image is not None for frame in world.frames[-20:])


def changes(seen: dict[float, SourceStatus]) -> list[tuple[State, str]]:
    out: list[tuple[State, str]] = []
    for _, health in sorted(seen.items()):
        if not out or out[-1] != (health.state, health.detail):
            out.append((health.state, health.detail))
    return out


def test_a_camera_that_opens_and_sends_nothing_is_lost_once_and_steadily() -> None:
    camera = Plugged(OURS, is_silent=True)
    world = World(video0=camera)
    world.events.append((32.0, lambda: setattr(camera, "is_silent", False)))
    seen = run(live(world), world, 36.0)
    assert changes({t: h for t, h in seen.items() if 0.1 < t < 32.0}) == [
        (State.STARTING, "/dev/video0: waiting for its first picture"),
        (State.LOST, "/dev/video0: opens but sends no picture"),
    ]
    assert first(seen, State.LOST, 0.1) == pytest.approx(5.0, abs=0.3)
    assert at(seen, 32.0).figures["reopened"] >= 5.0  # it is tried again all the while
    assert at(seen, 35.9).state is State.OK


def test_a_camera_that_falls_silent_and_opens_again_in_vain_stays_lost() -> None:
    camera = Plugged(OURS)
    world = World(video0=camera)
    world.events.append((2.0, lambda: setattr(camera, "is_silent", True)))
    seen = run(live(world), world, 30.0)
    assert {h.state for t, h in seen.items() if t > 4.0} == {State.LOST}
    assert {h.detail for t, h in seen.items() if t > 12.0} == {"/dev/video0: opens but sends no picture"}


def test_a_camera_whose_stream_breaks_before_every_first_picture_does_not_start_again_and_again() -> None:
    camera = Plugged(OURS, fault=errno.EIO)
    world = World(video0=camera)
    world.events += [(0.5 * n, lambda: setattr(camera, "fault", errno.EIO)) for n in range(1, 20)]
    camera.is_silent = True
    seen = run(live(world), world, 10.0)
    assert {h.state for t, h in seen.items() if t > 1.0} == {State.LOST}


def test_a_hanging_driver_is_seen_while_it_hangs() -> None:
    world = World(video0=Plugged(OURS))
    camera = live(world)
    seen: list[SourceStatus] = []

    def hang() -> None:
        world.now_ns += 3_000_000_000  # the ioctl does not return
        seen.append(camera.health())

    world.events = [(1.0, hang)]
    run(camera, world)
    assert seen[0].state is State.LOST


def test_pictures_that_waited_while_we_were_starved_are_not_shown_as_news() -> None:
    world = World(video0=Plugged(OURS))
    camera = live(world)
    world.events = [(1.0, lambda: setattr(world, "now_ns", world.now_ns + 1_000_000_000))]
    run(camera, world)
    assert camera.health().figures["skipped"] > 5
    assert all(arrival_ns - frame.stamp_ns <= 500_000_000 for arrival_ns, frame in world.emitted)


def test_a_time_of_arrival_is_never_given_to_a_picture_that_waited() -> None:
    world = World(video0=Plugged(OURS, flags=v4l2.BUF_FLAG_TIMESTAMP_UNKNOWN, age_ns=-(10**17)))
    camera = live(world)
    # Kept from running for a second, within the wait for a picture: the queue is full of old ones then.
    world.events = [(1.01, lambda: setattr(world, "now_ns", world.now_ns + 1_000_000_000))]
    seen = run(camera, world)
    assert at(seen, 0.9).state is State.DEGRADED
    numbers = {bytes(picture(number)): number for number in range(200)}
    late_ms = []
    for frame in world.frames:
        taken_ns = world.begun_ns + numbers[frame.image.tobytes()] * PERIOD_NS
        late_ms.append((frame.stamp_ns - CLOCK.from_monotonic_ns(taken_ns)) / 1e6)
    assert len(late_ms) > 80
    assert max(late_ms) < 40.0


def test_before_it_runs_it_is_starting() -> None:
    assert live(World()).health().state is State.STARTING


def test_a_slow_camera_is_not_lost_between_two_pictures() -> None:
    assert patience_s(CameraConfig(lost_after_s=1.5, rate_hz=0.5)) == pytest.approx(6.0)
    assert patience_s(CameraConfig(lost_after_s=1.5, rate_hz=30.0)) == pytest.approx(1.5)

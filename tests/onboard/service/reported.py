"""What the parts of a daemon may say, for property tests; and the report that a session makes of it."""

from dataclasses import replace

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from contract.feature_set import Status
from contract.supervised_thread import ThreadReport, ThreadState
from contract.vehicle_status import VehicleStatus
from onboard.events.source import SourceStatus, State
from onboard.service.reports import Brightness, RecordingReport, Report
from onboard.service.vehicle_state import GpsReport, Inputs, judge, overall

# On a busy machine a draw may take a second: no fault of what is tested.
unhurried = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
OK = SourceStatus(State.OK)
FIGURES = {"rate_hz": 29.8, "attitude_hz": 49.0, "position_hz": 10.0, "round_trip_ms": 2.5, "clock_sigma_ms": 0.9}
WELL = Inputs(OK, OK, 0.03, 0.0, Status.OK, GpsReport(3, 0.2, 14, 0.8))


def inputs() -> st.SearchStrategy[Inputs]:
    """Anything the parts may say, all of them well about as often as not."""
    sources = st.just(OK) | st.builds(SourceStatus, st.sampled_from(State), st.just("because"))
    gps = st.builds(GpsReport, st.integers(0, 6), st.floats(0, 6), st.just(14), st.none() | st.floats(0.1, 10.0))
    threads = st.builds(
        ThreadReport, st.sampled_from(["camera", "link"]), st.sampled_from(ThreadState), st.none(), st.just(0),
        st.sampled_from(["", "OSError: gone"]),
    )  # fmt: skip
    anything = st.builds(
        Inputs,
        sources,
        sources,
        st.none() | st.floats(0, 10),
        st.floats(0, 10),
        st.none() | st.sampled_from(Status),
        st.none() | gps,
        st.sampled_from(["", "far from the first one"]),
        st.booleans(),
        st.booleans(),
        st.sampled_from(["", "disk full"]),
        st.lists(threads, max_size=2).map(tuple),
        st.sampled_from(["", "tilt contradicts the other sensors"]),
        st.none() | sources,
    )
    # Anything at all is never well: most findings must be seen alone too.
    names = ["camera", "telemetry", "picture_age_s", "busy_s", "outcome", "gps", "position_fault", "is_at_rest",
             "is_shedding", "recording_fault", "threads", "contradiction", "thermal_camera"]  # fmt: skip
    few = st.lists(st.sampled_from(names), max_size=2)
    return anything | st.builds(lambda a, n: replace(WELL, **{name: getattr(a, name) for name in n}), anything, few)


def report_of(reported: Inputs) -> Report:
    """As a session reports it, with figures that no one finds fault with."""
    state = overall(reported)
    status = VehicleStatus(1.7e9, 7, state.state.value, state.reason, 60.0, 29.8, 29.0, 300, 0.125, 97)
    return Report(
        status,
        replace(reported.camera, figures=FIGURES),
        replace(reported.telemetry, figures=FIGURES),
        judge(reported),
        Brightness(120.0, 0.01, 0.02),
        reported.gps,
        threads=reported.threads,
        recording=RecordingReport(not reported.recording_fault, reported.recording_fault),
        thermal_camera=reported.thermal_camera,
    )

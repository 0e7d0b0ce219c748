"""Requests to look at a place: every one comes back as it was, and nothing that is none is taken for one."""

import dataclasses
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.errors import InputError, LinkError
from contract.look import (
    AskCircle,
    AskLook,
    Circle,
    ConfirmLook,
    EndLook,
    LookRequest,
    Offer,
    look_key,
    parameters_of,
    read_request,
)

TICKETS = st.text("0123456789abcdef", min_size=1, max_size=32)
WHOLE = st.integers(0, 2**32 - 1)
REQUESTS = st.one_of(
    st.builds(
        AskLook,
        WHOLE,
        WHOLE,
        st.floats(-0.5, 65535.0),
        st.floats(-0.5, 65535.0),
        st.floats(-90.0, 90.0),
        st.floats(-180.0, 180.0),
        st.floats(0.0, 1e5),
    ),
    st.builds(ConfirmLook, TICKETS, st.floats(0.0, 30.0)),
    st.just(EndLook()),
    st.builds(AskCircle, TICKETS),
)


@given(REQUESTS)
def test_a_request_comes_back_as_it_was(request_: LookRequest) -> None:
    back = read_request(parameters_of(request_))
    assert type(back) is type(request_)
    if isinstance(request_, AskLook) and isinstance(back, AskLook):
        same = ("session", "frame", "u_px", "v_px")
        assert [getattr(back, name) for name in same] == [getattr(request_, name) for name in same]
        assert abs(back.lat_deg - request_.lat_deg) < 1e-9 and abs(back.lon_deg - request_.lon_deg) < 1e-9
    elif isinstance(request_, ConfirmLook) and isinstance(back, ConfirmLook):
        assert back.ticket == request_.ticket and abs(back.waited_s - request_.waited_s) <= 0.0051
    else:
        assert back == request_


GOOD = "session=1;frame=2;u=3.0;v=4.0;lat=47.0;lon=8.0;radius=2.0"


@pytest.mark.parametrize(
    ("wrong", "word"),
    [
        ("", "is asked for with"),
        ("end=2", "is asked for with"),
        ("end=1;end=1", "given twice"),
        ("ticket=ab", "is asked for with"),
        ("circle=a/b", "circle: not the ticket"),
        ("circle=ab;waited=1", "is asked for with"),
        ("ticket=a/b;waited=1", "ticket"),
        ("ticket=;waited=1", "ticket"),
        ("ticket=ab;waited=nan", "waited"),
        ("ticket=ab;waited=-1", "waited"),
        (GOOD.replace("lat=47.0", "lat=nan"), "lat"),
        (GOOD.replace("lat=47.0", "lat=90.1"), "lat"),
        (GOOD.replace("lon=8.0", "lon=inf"), "lon"),
        (GOOD.replace("lon=8.0", "lon=" + "8" * 40), "lon"),
        (GOOD.replace("u=3.0", "u=1e9"), "u:"),
        (GOOD.replace("radius=2.0", "radius=-1"), "radius"),
        (GOOD.replace("session=1", "session=1.0"), "session"),
        (GOOD.replace("frame=2", "frame=4294967296"), "frame"),
        (GOOD.replace("frame=2", "frame=²"), "frame"),
        (GOOD + ";height=3", "is asked for with"),
        ("x" * 301, "more than 300"),
    ],
)
def test_what_is_no_request_is_refused_in_a_line(wrong: str, word: str) -> None:
    with pytest.raises(InputError, match=word):
        read_request(wrong)


@given(st.text(max_size=400))
def test_no_text_does_more_than_be_refused(text: str) -> None:
    try:
        read_request(text)
    except InputError as error:
        assert "\n" not in str(error) or "\n" in text


def test_an_offer_comes_back_to_a_decimetre_and_what_is_none_is_refused() -> None:
    offer = Offer("ab12", -35.1234567, 149.7654321, 412.3, 3.4, 1.5)
    content = json.loads(offer.to_json())
    assert Offer.of(content) == offer
    for key, value in (("lat_deg", None), ("lon_deg", "8"), ("height_amsl_m", True), ("ticket", 3), ("age_s", 1e999)):
        with pytest.raises(LinkError, match="cannot be read"):
            Offer.of(content | {key: value})
    about = dataclasses.replace(offer, circle=Circle(120.0, 512.3, 100.0))
    content = json.loads(about.to_json())
    assert Offer.of(content) == about
    for wrong in (3, {}, content["circle"] | {"radius_m": None}, content["circle"] | {"height_amsl_m": math.nan}):
        with pytest.raises(LinkError, match="cannot be read"):
            Offer.of(content | {"circle": wrong})


def test_a_name_opens_one_key_and_no_wildcard_is_a_name() -> None:
    assert look_key("uav-1", "anna") == "pc/uav-1/look/anna"
    for name in ("", "*", "a/b", "**", "a b", "x" * 33, "$*"):
        with pytest.raises(ValueError, match="must be"):
            look_key("uav-1", name)

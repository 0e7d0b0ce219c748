"""Having an aircraft's camera look at a place, over the link: asked about, confirmed, ended. See `contract.look`."""

from __future__ import annotations

from typing import Any

import zenoh

from contract.closing import Closing
from contract.errors import LinkError
from contract.link_config import Tls
from contract.look import (
    ANSWERED_WITHIN_S,
    AskCircle,
    AskLook,
    ConfirmLook,
    EndLook,
    LookRequest,
    Offer,
    look_key,
    parameters_of,
)
from ground.certificate_name import common_name
from ground.client import only_vehicle, open_link
from ground.put_request import put_request

WITHOUT_TLS = (
    "the camera is sent somewhere only by who has a certificate that the aircraft names in link.pointers: "
    "--credentials (docs/look-there.md)"
)


class LookLink(Closing):
    """A session with one aircraft: `vehicle`, or the only one there is. `name` is our certificate's.

    Raises LinkError. What is asked raises RequestRefused with the aircraft's reason, LinkError if it gives no answer.
    """

    def __init__(self, endpoint: str, vehicle: str | None, tls: Tls | None) -> None:
        if tls is None:
            raise LinkError(WITHOUT_TLS)
        self.name = common_name(tls.certificate)
        self._session: Any = open_link("client", endpoint, tls)
        try:
            self.vehicle = vehicle or only_vehicle(self._session, endpoint)
            self._key = look_key(self.vehicle, self.name)
        except (zenoh.ZError, ValueError) as error:
            self.close()
            raise LinkError(f"cannot ask at {endpoint}: {error}") from error
        except LinkError:
            self.close()
            raise

    def ask(self, request: AskLook | AskCircle) -> Offer:
        """The place that the aircraft would have its camera look at, or would circle about."""
        return Offer.of(self.put(request))

    def confirm(self, offer: Offer, waited_s: float) -> dict[str, Any]:
        """Have it done, `waited_s` after the offer came here. The autopilot has accepted it."""
        return self.put(ConfirmLook(offer.ticket, waited_s))

    def end(self) -> dict[str, Any]:
        """Have it look there no longer. The autopilot has accepted it."""
        return self.put(EndLook())

    def put(self, request: LookRequest) -> dict[str, Any]:
        """The aircraft's answer as it came."""
        # A click and a ticket that are asked about again have the same answer: what is lost may be sent once more.
        selector = f"{self._key}?{parameters_of(request)}"
        answer = put_request(self._session, selector, timeout_s=ANSWERED_WITHIN_S)
        if answer is None and isinstance(request, ConfirmLook):
            raise LinkError(f"aircraft {self.vehicle!r} has not answered: it may have been done or not")
        if answer is None:
            raise LinkError(
                f"aircraft {self.vehicle!r} does not answer {self.name!r}: is that name in its link.pointers?"
            )
        return answer

    def close(self) -> None:
        self._session.close()

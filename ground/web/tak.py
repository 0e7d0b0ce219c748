"""One pin to a TAK server, when somebody presses for it; `pc-ground cot` sends all of them again and again."""

from __future__ import annotations

import time
from typing import Any

from fastapi import APIRouter, HTTPException

from ground.cot_sender import CotSender
from ground.formats import cot
from ground.formats.documents import COT_STALE_S
from ground.formats.mark import Mark
from ground.web.dependency import Context

# Routes below /api.
router = APIRouter(tags=["hand-off and export"])


@router.post("/pins/{pin_id}/tak", summary="Send a pin to the TAK server that this server was started with")
def send(context: Context, pin_id: str) -> dict[str, Any]:
    if context.tak is None:
        raise HTTPException(409, "this server was started without --tak: there is nowhere to send it")
    pin = context.pin(pin_id)
    mark = Mark.of_pin(pin, context.places.place(pin))
    event = cot.event(mark, time.time_ns(), COT_STALE_S, is_kept=True)
    if event is None:
        raise HTTPException(409, f"pin {pin.number} has no position to send: {mark.reason}")
    with CotSender(context.tak) as sender:
        sender.connect()
        sender.send([event])
        sender.finish()  # a server that refuses us does so only now
    return {"sent": context.tak.name}

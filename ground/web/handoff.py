"""Passing a pin on: its coordinate in every format, a sentence for the radio, a code for a phone, and files of all pins."""

from __future__ import annotations

from fastapi import APIRouter

from ground.web.desk import Desk


def handoff_router(desk: Desk) -> APIRouter:
    """Routes below /api."""
    return APIRouter(tags=["hand-off and export"])

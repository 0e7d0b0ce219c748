"""The server context as routes get it: a parameter of the type Context."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends
from starlette.requests import HTTPConnection

from ground.web.context import ServerContext


async def _of_the_server(connection: HTTPConnection) -> ServerContext:
    found: ServerContext = connection.app.state.context
    return found


Context = Annotated[ServerContext, Depends(_of_the_server)]

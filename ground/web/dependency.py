"""Parameters of routes: the server context, of the type Context, and bodies."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends
from pydantic import BaseModel, ConfigDict
from starlette.requests import HTTPConnection

from ground.web.context import ServerContext


async def _of_the_server(connection: HTTPConnection) -> ServerContext:
    found: ServerContext = connection.app.state.context
    return found


Context = Annotated[ServerContext, Depends(_of_the_server)]


class Body(BaseModel):
    """The body of a request: what is not a field of it is refused."""

    model_config = ConfigDict(extra="forbid")

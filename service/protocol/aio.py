"""The asyncio client of both sockets."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from faultline.service.protocol.connection import LONGEST
from faultline.service.protocol.errors import AwayError, GarbledError


@asynccontextmanager
async def connected(path: Path, first: bytes) -> AsyncIterator[asyncio.StreamReader]:
    """Connect to a socket of the service and send `first`, one line; yield the reader.

    Raises:
        AwayError: nobody serves there.
    """
    try:
        reader, writer = await asyncio.open_unix_connection(path, limit=LONGEST)
    except OSError as error:
        raise AwayError(error.strerror or str(error), path) from error
    try:
        writer.write(first)
        yield reader
    finally:
        writer.transport.abort()


async def line_of(reader: asyncio.StreamReader) -> bytes:
    """Return the next whole line, newline included.

    Raises:
        AwayError: the connection ended before it did.
        GarbledError: it is longer than any answer.
    """
    try:
        line = await reader.readline()
    except OSError as error:
        raise AwayError(str(error)) from error
    except ValueError as error:
        raise GarbledError(f"a line of more than {LONGEST} bytes") from error
    if not line.endswith(b"\n"):
        raise AwayError("the connection ended")
    return line


async def answer(path: Path, question: bytes) -> bytes:
    """Return the line that answers one question, on a connection of its own; raises as `line_of` and `connected`."""
    async with connected(path, question) as reader:
        return await line_of(reader)

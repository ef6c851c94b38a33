"""A TCP relay between one member and the router, whose line can be cut."""

from __future__ import annotations

import asyncio
import contextlib
import enum

CHUNK = 1 << 18


class Line(enum.Enum):
    """What the relay does with what comes in."""

    WHOLE = "whole"
    # As if a cable were pulled: connections stay, nothing passes, and what was sent arrives when the cable is back.
    SILENT = "silent"
    # As if the other machine had gone: connections are reset, new ones too.
    RESET = "reset"


class Relay:
    """Listens on a port of its own and passes every connection on to the router."""

    def __init__(self, router_port: int) -> None:
        self.port = 0
        self.line = Line.WHOLE
        self.n_connections = 0
        self._router_port = router_port
        self._passing = asyncio.Event()
        self._passing.set()
        self._writers: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None

    async def listen(self) -> None:
        """Takes connections from now on."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0, limit=CHUNK)
        self.port = self._server.sockets[0].getsockname()[1]

    def cut(self, line: Line) -> None:
        """Cuts all connections, and those that come, until `mend`."""
        self.line = line
        self._passing.clear()
        if line is Line.RESET:
            self._abort()

    def mend(self) -> None:
        """Passes everything on again."""
        self.line = Line.WHOLE
        self._passing.set()

    async def close(self) -> None:
        """Takes nothing more and drops what there is."""
        self.mend()
        if self._server is not None:
            self._server.close()
        self._abort()

    def _abort(self) -> None:
        for writer in self._writers:
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.n_connections += 1
        if self.line is Line.RESET:
            writer.transport.abort()
            return
        self._writers.add(writer)
        there: asyncio.StreamWriter | None = None
        try:
            await self._passing.wait()
            back, there = await asyncio.open_connection("127.0.0.1", self._router_port, limit=CHUNK)
            self._writers.add(there)
            pumps = [asyncio.create_task(self._pump(reader, there)), asyncio.create_task(self._pump(back, writer))]
            # One direction that ends takes the other with it, as with a process that is gone.
            _, left = await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
            for pump in left:
                pump.cancel()
            await asyncio.gather(*pumps, return_exceptions=True)
        except OSError:
            # No router listens at the moment: the member sees its connection end and comes back.
            pass
        finally:
            for end in (writer, there):
                if end is not None:
                    self._writers.discard(end)
                    end.close()

    async def _pump(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await source.read(CHUNK):
                await self._passing.wait()
                sink.write(data)
                await sink.drain()

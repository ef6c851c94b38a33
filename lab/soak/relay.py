"""A TCP relay between one member and the router that can cut the connection."""

from __future__ import annotations

import asyncio
import contextlib
import enum

CHUNK = 1 << 18


class Line(enum.Enum):
    """How the relay treats traffic."""

    WHOLE = "whole"
    # Like a pulled cable: connections stay open, nothing passes, and sent data arrives when the cable is back.
    SILENT = "silent"
    # As if the other machine were gone: all connections are reset, including new ones.
    RESET = "reset"


class Relay:
    """Listens on its own port and forwards every connection to the router."""

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
        """Starts accepting connections."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0, limit=CHUNK)
        self.port = self._server.sockets[0].getsockname()[1]

    def cut(self, line: Line) -> None:
        """Cuts all current and new connections until `mend`."""
        self.line = line
        self._passing.clear()
        if line is Line.RESET:
            self._abort()

    def mend(self) -> None:
        """Forwards all traffic again."""
        self.line = Line.WHOLE
        self._passing.set()

    async def close(self) -> None:
        """Stops accepting connections and drops open ones."""
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
            # When one direction ends, end the other too, as if the process were gone.
            _, left = await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
            for pump in left:
                pump.cancel()
            await asyncio.gather(*pumps, return_exceptions=True)
        except OSError:
            # No router is listening right now. The member's connection closes, and it reconnects.
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

"""A TCP relay between one member and the router that can cut the connection."""

import asyncio
import contextlib

CHUNK = 1 << 18


class Relay:
    """Listens on its own port and forwards every connection to the router."""

    def __init__(self, router_port: int) -> None:
        self.port = 0
        self._is_reset = False
        self._router_port = router_port
        self._passing = asyncio.Event()
        self._passing.set()
        self._writers: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None

    async def listen(self) -> None:
        """Starts accepting connections."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0, limit=CHUNK)
        self.port = self._server.sockets[0].getsockname()[1]

    def cut(self, reset: bool) -> None:
        """Cuts all current and new connections until `mend`.

        Like a pulled cable: nothing passes, and what was sent arrives when the cable is back. With `reset`, as if the
        other machine were gone.
        """
        self._passing.clear()
        self._is_reset = reset
        if reset:
            self._abort()

    def mend(self) -> None:
        """Forwards all traffic again."""
        self._is_reset = False
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
        if self._is_reset:
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

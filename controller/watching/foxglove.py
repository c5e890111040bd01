"""A live stream for Foxglove: what is recorded, as it is recorded. It takes no command and offers no service."""

from collections.abc import Mapping
from contextlib import suppress

import foxglove

PORT = 8765
"""Where Foxglove looks for a stream by default (its documentation, "Foxglove WebSocket")."""


class FoxgloveStream:
    """Publishes on loopback.

    The recorder's thread feeds it and never waits. A slow client loses the oldest messages (the SDK's own backlog).

    Args:
        port: Where; 0 takes one that is free.

    Raises:
        RuntimeError: the port is taken.
    """

    def __init__(self, port: int = PORT) -> None:
        self._context = foxglove.Context()
        self._server = foxglove.start_server(
            name="touchbench", port=port, capabilities=[], context=self._context
        )
        self._present: dict[int, foxglove.Channel] = {}

    @property
    def address(self) -> str:
        """The address to open in Foxglove."""
        return f"ws://127.0.0.1:{self._server.port}"

    def channel(
        self, number: int, topic: str, schema: tuple[str, bytes], metadata: Mapping[str, str]
    ) -> None:
        """A topic of the recording; raw blocks and spans without a subscriber are for programs, and left out."""
        if topic.startswith(("/raw/", "/skipped")):
            return
        with suppress(Exception):  # a view never ends a run
            described = foxglove.Schema(name=schema[0], encoding="protobuf", data=schema[1])
            self._present[number] = foxglove.Channel(
                topic,
                schema=described,
                message_encoding="protobuf",
                context=self._context,
                metadata=dict(metadata),
            )

    def message(self, number: int, log_time_ns: int, data: bytes) -> None:
        """A message of a topic."""
        if number in self._present:
            with suppress(Exception):
                self._present[number].log(data, log_time=log_time_ns)

    def close(self) -> None:
        """End the stream."""
        self._server.stop()

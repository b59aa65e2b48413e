"""A recording for Foxglove while it is being written, over a WebSocket."""

from __future__ import annotations

from typing import Self

import foxglove
from foxglove.websocket import ChannelView, Client, ServerListener, WebSocketServer

from lidar_emu.viewer.addresses import LOCAL, check_free
from lidar_emu.viewer.flight_parts import FlightPart
from lidar_emu.viewer.ros2_messages import STANDING, encoded, messages_of, schema_of

_BACKLOG = 1 << 14
"""Messages that a client may be behind: a shot of four beams has 19."""


class FoxgloveServer(ServerListener):
    """Sends parts of a recording to all clients on this machine; one that is slow loses the oldest messages.

    Args:
        name: name of the server, for its clients.

    Raises:
        InputError: the port is in use.
    """

    def __init__(self, name: str, port: int) -> None:
        check_free("--port", port)
        foxglove.set_log_level("CRITICAL")  # clients may leave at any time
        self._name, self._port = name, port
        self._context = foxglove.Context()
        self._channels: dict[str, foxglove.Channel] = {}
        self._standing: dict[str, tuple[int, bytes]] = {}
        self._subscribed: list[set[str]] = [set(), set(), set()]
        self._listening: WebSocketServer | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._listening is not None:
            self._listening.stop()

    @property
    def is_listening(self) -> bool:
        """Whether clients are accepted."""
        return self._listening is not None

    def listen(self) -> None:
        """Accept clients.

        After the first part: the library refuses clients that subscribe to a topic in the instant that it is new.
        """
        self._listening = foxglove.start_server(
            name=self._name,
            host=LOCAL,
            port=self._port,
            server_listener=self,
            context=self._context,
            message_backlog_size=_BACKLOG,
        )

    def show(self, part: FlightPart) -> None:
        """Send a part."""
        for time_ns, topic, message in messages_of(part):
            data = encoded(message)
            if topic in STANDING:
                self._standing[topic] = time_ns, data
            if topic not in self._channels:
                kind, definition = schema_of(message)
                schema = foxglove.Schema(name=kind, encoding="ros2msg", data=definition)
                self._channels[topic] = foxglove.Channel(
                    topic, schema=schema, message_encoding="cdr", context=self._context
                )
            self._channels[topic].log(data, log_time=time_ns)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002
        """Note that a client lacks what was sent before and still stands."""
        self._subscribed[-1].add(channel.topic)

    def send_again(self) -> None:
        """Send what still stands to new clients, and so to all, some calls after they have subscribed.

        The library notifies of a subscription before it takes effect, and names no client to send to.
        """
        due = self._subscribed.pop(0)
        self._subscribed.append(set())
        for topic in due & self._standing.keys():
            time_ns, data = self._standing[topic]
            self._channels[topic].log(data, log_time=time_ns)

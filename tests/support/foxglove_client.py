"""Clients of Foxglove's WebSocket: one that decodes all it gets, one that reads nothing, one that floods."""

from __future__ import annotations

import base64
import json
import os
import socket
import struct
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

_PROTOCOL = "foxglove.sdk.v1"
_DATA = struct.Struct("<BIQ")
_TEXT_FRAME = 0x81

Messages = dict[str, list[tuple[int, Any]]]
"""Times and decoded messages by topic."""


class FoxgloveClient:
    """Subscribes to every topic as soon as it is there, and decodes its messages by the schemas that it is sent."""

    def __init__(self, port: int) -> None:
        self._url = f"ws://127.0.0.1:{port}"
        self._decoders: dict[int, tuple[str, Callable[[bytes], Any]]] = {}
        self.messages: Messages = defaultdict(list)

    async def receive(self, until: Callable[[], bool]) -> None:
        """Receive until a condition holds."""
        request = HTTPRequest(self._url)
        connection = await websocket_connect(request, subprotocols=[_PROTOCOL], max_message_size=1 << 28)
        while not until():
            data = await connection.read_message()
            assert data is not None, "the server has closed the connection"
            if isinstance(data, str):
                if channels := json.loads(data).get("channels"):
                    await connection.write_message(self._subscribe(channels))
                continue
            code, number, time_ns = _DATA.unpack_from(data)
            assert code == 1
            topic, decode = self._decoders[number]
            self.messages[topic].append((time_ns, decode(data[_DATA.size :])))
        connection.close()
        while await connection.read_message() is not None:
            pass

    def _subscribe(self, channels: list[dict[str, Any]]) -> str:
        for channel in channels:
            data = channel["schema"].encode()
            number, name = channel["id"], channel["schemaName"]
            schema = Schema(id=number, name=name, encoding=channel["schemaEncoding"], data=data)
            decode = DecoderFactory().decoder_for(channel["encoding"], schema)
            assert decode is not None
            self._decoders[number] = channel["topic"], decode
        return subscription([channel["id"] for channel in channels])


def subscription(channels: list[int]) -> str:
    """The message that subscribes to channels, under their own numbers."""
    wanted = [{"id": number, "channelId": number} for number in channels]
    return json.dumps({"op": "subscribe", "subscriptions": wanted})


def connect(port: int) -> socket.socket:
    """A WebSocket from which nothing is read."""
    connection = socket.create_connection(("127.0.0.1", port))
    key = base64.b64encode(os.urandom(16)).decode()
    headers = ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
    lines = ["GET / HTTP/1.1", f"Host: 127.0.0.1:{port}", *headers]
    lines += [f"Sec-WebSocket-Key: {key}", f"Sec-WebSocket-Protocol: {_PROTOCOL}", "", ""]
    try:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.sendall("\r\n".join(lines).encode())
    except OSError:
        connection.close()
        raise
    return connection


def send_text(connection: socket.socket, text: str) -> None:
    """Send a text frame, masked by zeros."""
    data = text.encode()
    connection.sendall(struct.pack(">BBH4x", _TEXT_FRAME, 0x80 | 126, len(data)) + data)

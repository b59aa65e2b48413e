"""A file on a disk that may be full."""

from __future__ import annotations

import errno
import os
from io import FileIO
from typing import Any


class DiskFile(FileIO):
    """A file that takes so many bytes more."""

    room_bytes: int | None = None
    """None: as many as there are."""
    refused = False
    """Whether the disk has refused bytes."""

    def write(self, data: Any) -> int:
        if self.room_bytes is None:
            return super().write(data)
        data = bytes(data)[: self.room_bytes]
        if not data:
            self.refused = True
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.room_bytes -= len(data)
        return super().write(data)

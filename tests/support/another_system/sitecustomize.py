"""Python without the modules and calls that it has on Linux alone; Python imports this file at its start."""

import os
import select
import signal
import socket
import sys

MODULES = "fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"
CALLS = {
    os: "O_NOCTTY O_NONBLOCK memfd_create openpty sched_getaffinity sched_getparam sched_getscheduler "
    "sched_param sched_setaffinity sched_setscheduler set_blocking ttyname",
    select: "epoll poll",
    signal: "SIGHUP pthread_sigmask",
    socket: "AF_UNIX",
}

sys.modules.update(dict.fromkeys(MODULES))
for module, names in CALLS.items():
    for name in names.split():
        delattr(module, name)

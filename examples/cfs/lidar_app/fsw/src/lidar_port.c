#define _DEFAULT_SOURCE
#include "lidar_port.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <termios.h>
#include <unistd.h>

static int port = -1;

bool lidar_port_open(const char *path) {
    struct termios settings;
    port = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (port < 0 || tcgetattr(port, &settings) != 0)
        return false;
    cfmakeraw(&settings);
    settings.c_cflag |= CLOCAL | CREAD;
    return cfsetspeed(&settings, B921600) == 0 && tcsetattr(port, TCSANOW, &settings) == 0;
}

long lidar_port_read(uint8_t *bytes, size_t size) {
    const ssize_t count = read(port, bytes, size);
    if (count > 0)
        return (long)count;
    struct pollfd state = {.fd = port};
    const bool is_gone = poll(&state, 1, 0) > 0; /* only an error or a hang-up can be reported here */
    return is_gone || (count < 0 && errno != EAGAIN && errno != EINTR) ? -1 : 0;
}

bool lidar_port_write(const uint8_t *bytes, size_t length) {
    return write(port, bytes, length) == (ssize_t)length;
}

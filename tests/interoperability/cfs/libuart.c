#define _DEFAULT_SOURCE
#include "libuart.h"

#include <fcntl.h>
#include <sys/ioctl.h>
#include <unistd.h>

int32_t uart_init_port(uart_info_t *device) {
    device->handle = open(device->deviceString, O_RDWR | O_NOCTTY);
    if (device->handle < 0 || device->baud != 921600 || tcgetattr(device->handle, &device->options) != 0)
        return -1;
    cfmakeraw(&device->options);
    return tcsetattr(device->handle, TCSANOW, &device->options) == 0 ? UART_SUCCESS : -1;
}

int32_t uart_bytes_available(uart_info_t *device) {
    int available = 0;
    return ioctl(device->handle, FIONREAD, &available) == 0 ? available : -1;
}

int32_t uart_read_port(uart_info_t *device, uint8_t data[], const uint32_t numBytes) {
    return (int32_t)read(device->handle, data, numBytes);
}

int32_t uart_write_port(uart_info_t *device, uint8_t data[], const uint32_t numBytes) {
    return (int32_t)write(device->handle, data, numBytes);
}

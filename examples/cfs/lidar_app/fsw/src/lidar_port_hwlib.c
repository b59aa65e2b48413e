#include "lidar_port.h"

#include "libuart.h"

/* On hwlib's buses of NOS Engine the handle is the number of the bus. */
static uart_info_t uart = {.handle = 0, .baud = 921600, .access_option = uart_access_flag_RDWR};

bool lidar_port_open(const char *path) {
    uart.deviceString = path;
    return uart_init_port(&uart) == UART_SUCCESS;
}

long lidar_port_read(uint8_t *bytes, size_t size) {
    const int32_t available = uart_bytes_available(&uart);
    if (available <= 0)
        return available;
    return uart_read_port(&uart, bytes, (size_t)available < size ? (uint32_t)available : (uint32_t)size);
}

bool lidar_port_write(const uint8_t *bytes, size_t length) {
    uint8_t data[64];
    if (length > sizeof data)
        return false;
    for (size_t k = 0; k < length; k++)
        data[k] = bytes[k];
    return uart_write_port(&uart, data, (uint32_t)length) == (int32_t)length;
}

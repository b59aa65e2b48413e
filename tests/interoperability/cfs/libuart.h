/* What examples/cfs uses of NOS3's hwlib: its names, on the ttys of POSIX as its build for Linux has them. */
#ifndef LIBUART_H
#define LIBUART_H

#include <stdint.h>
#include <termios.h>

#define UART_SUCCESS 0

typedef enum { uart_access_flag_RDONLY, uart_access_flag_WRONLY, uart_access_flag_RDWR } uart_access_flag;

typedef struct {
    const char *deviceString;
    int32_t handle;
    uint8_t isOpen;
    uint32_t baud;
    uint8_t canonicalModeOn;
    struct termios options;
    uart_access_flag access_option;
} uart_info_t;

int32_t uart_init_port(uart_info_t *device);
int32_t uart_bytes_available(uart_info_t *device);
int32_t uart_read_port(uart_info_t *device, uint8_t data[], const uint32_t numBytes);
int32_t uart_write_port(uart_info_t *device, uint8_t data[], const uint32_t numBytes);

#endif

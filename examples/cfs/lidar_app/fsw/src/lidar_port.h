/* The serial port of the lidar: lidar_port.c is a tty of POSIX, lidar_port_hwlib.c a UART of NOS3's hwlib. */
#ifndef LIDAR_PORT_H
#define LIDAR_PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Open a port in raw mode, at 921600 baud. */
bool lidar_port_open(const char *path);

/* Take what has arrived, at most `size` bytes, without waiting; return its length, -1 if the port is gone. */
long lidar_port_read(uint8_t *bytes, size_t size);

/* Whether all bytes were taken. */
bool lidar_port_write(const uint8_t *bytes, size_t length);

#endif

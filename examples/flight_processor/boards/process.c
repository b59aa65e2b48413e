/* A process of Linux: ./firmware <>PORT. It reads and writes the port, its standard input, and reports on its standard output. */
#define _DEFAULT_SOURCE
#include "board.h"

#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

void board_start(void) {
    struct termios settings;
    if (tcgetattr(STDIN_FILENO, &settings) != 0) {
        fputs("the standard input is no port: ./firmware <>PORT\n", stderr);
        exit(2);
    }
    cfmakeraw(&settings);
    (void)tcsetattr(STDIN_FILENO, TCSANOW, &settings);
}

/* Waits for a byte. The process ends when the port does. */
int board_read_lidar(void) {
    uint8_t byte;
    if (read(STDIN_FILENO, &byte, 1u) != 1)
        exit(0);
    return byte;
}

void board_write_lidar(const uint8_t *data, size_t length) {
    while (length > 0u) {
        const ssize_t written = write(STDIN_FILENO, data, length);
        if (written <= 0)
            exit(0);
        data += written;
        length -= (size_t)written;
    }
}

void board_write_report(char letter) {
    (void)putchar(letter);
    if (letter == '\n')
        (void)fflush(stdout);
}

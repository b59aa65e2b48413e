/* LEON3 (SPARC V8, big-endian) with one APBUART, the lidar's. Reports go to a place in memory that a debugger reads. */
#include "board.h"

typedef struct {
    volatile uint32_t data, status, control, scaler;
} uart;

enum { RECEIVED = 1, TRANSMIT_EMPTY = 4, ENABLE_BOTH = 3, REPORT_BYTES = 1 << 20 };
static uart *const lidar_uart = (uart *)0x80000100u;

/* At a fixed address, by the linker script: the length of the text so far, and the text. */
static struct {
    volatile uint32_t length;
    char text[REPORT_BYTES];
} report __attribute__((section(".report")));

/* Supervisor with traps disabled, floating-point unit on: nothing here traps, as -mflat needs no register windows. */
__asm__(".section \".text.start\", \"ax\"\n"
        ".global _start\n"
        "_start:\n"
        "    set 0x1080, %g1\n"
        "    wr %g1, 0, %psr\n"
        "    wr %g0, 0, %wim\n"
        "    nop\n"
        "    nop\n"
        "    nop\n"
        "    set stack_end - 96, %sp\n"
        "    call main\n"
        "    nop\n"
        ".previous\n");

void board_start(void) {
    lidar_uart->control = ENABLE_BOTH;
    report.length = 0u;
}

int board_read_lidar(void) {
    return (lidar_uart->status & RECEIVED) != 0u ? (int)(lidar_uart->data & 0xFFu) : -1;
}

void board_write_lidar(const uint8_t *data, size_t length) {
    for (size_t k = 0u; k < length; k++) {
        while ((lidar_uart->status & TRANSMIT_EMPTY) == 0u) {
        }
        lidar_uart->data = data[k];
    }
}

void board_write_report(char letter) {
    if (report.length < REPORT_BYTES)
        report.text[report.length++] = letter;
}

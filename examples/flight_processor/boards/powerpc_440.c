/* PowerPC 440EP of the board Bamboo, big-endian: the lidar on UART 0, reports on UART 1 (16550). */
#include "board.h"

typedef struct {
    volatile uint8_t data, interrupt, fifo, line_control, modem, status;
} uart;

enum { RECEIVED = 0x01, TRANSMIT_EMPTY = 0x20, EIGHT_BITS = 0x03, STACK_BYTES = 8192 };
enum { FIFO_ON = 0xC1 }; /* with the highest level for its interrupt: QEMU hands over bytes up to that level at once */
static uart *const lidar_uart = (uart *)0xEF600300u;
static uart *const report_uart = (uart *)0xEF600400u;

extern uint8_t stack[STACK_BYTES];
uint8_t stack[STACK_BYTES] __attribute__((aligned(16)));

/* The loader has cleared .bss and mapped all memory. The floating-point unit is off after a reset. */
__asm__(".section .text.start, \"ax\"\n"
        ".global _start\n"
        "_start:\n"
        "    mfmsr 3\n"
        "    ori 3, 3, 0x2000\n"
        "    mtmsr 3\n"
        "    isync\n"
        "    lis 1, stack + 8192 - 16@ha\n"
        "    addi 1, 1, stack + 8192 - 16@l\n"
        "    li 3, 0\n"
        "    stw 3, 0(1)\n"
        "    bl main\n"
        "    b .\n"
        ".previous\n");

void board_start(void) {
    lidar_uart->line_control = report_uart->line_control = EIGHT_BITS;
    lidar_uart->fifo = report_uart->fifo = FIFO_ON;
}

int board_read_lidar(void) { return (lidar_uart->status & RECEIVED) != 0u ? (int)lidar_uart->data : -1; }

static void put(uart *line, uint8_t byte) {
    while ((line->status & TRANSMIT_EMPTY) == 0u) {
    }
    line->data = byte;
}

void board_write_lidar(const uint8_t *data, size_t length) {
    for (size_t k = 0u; k < length; k++)
        put(lidar_uart, data[k]);
}

void board_write_report(char letter) { put(report_uart, (uint8_t)letter); }

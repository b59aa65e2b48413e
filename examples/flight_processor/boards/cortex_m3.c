/* Cortex-M3 of Arm's board MPS2, image AN385: the lidar on UART 0, reports on UART 1 (CMSDK UARTs). */
#include "board.h"

typedef struct {
    volatile uint32_t data, state, control, interrupt, divisor;
} uart;

enum { TRANSMIT_FULL = 1, RECEIVE_FULL = 2, ENABLE_BOTH = 3, DIVISOR = 27 }; /* 25 MHz / 921600 Bd */
static uart *const lidar_uart = (uart *)0x40004000u;
static uart *const report_uart = (uart *)0x40005000u;

int main(void);
void reset(void);
extern uint32_t stack_end, data_start, data_end, data_load, bss_start, bss_end;

typedef struct {
    uint32_t *stack_end;
    void (*reset)(void);
} vector_table;

__attribute__((section(".vectors"), used)) static const vector_table vectors = {&stack_end, reset};

void reset(void) {
    const uint32_t *from = &data_load;
    for (uint32_t *to = &data_start; to < &data_end; to++)
        *to = *from++;
    for (uint32_t *to = &bss_start; to < &bss_end; to++)
        *to = 0u;
    (void)main();
}

void board_start(void) {
    lidar_uart->divisor = report_uart->divisor = DIVISOR;
    lidar_uart->control = report_uart->control = ENABLE_BOTH;
}

int board_read_lidar(void) { return (lidar_uart->state & RECEIVE_FULL) != 0u ? (int)(lidar_uart->data & 0xFFu) : -1; }

static void put(uart *line, uint8_t byte) {
    while ((line->state & TRANSMIT_FULL) != 0u) {
    }
    line->data = byte;
}

void board_write_lidar(const uint8_t *data, size_t length) {
    for (size_t k = 0u; k < length; k++)
        put(lidar_uart, data[k]);
}

void board_write_report(char letter) { put(report_uart, (uint8_t)letter); }

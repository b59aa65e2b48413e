/* CTU CAN FD, a controller of 100 MHz, on a PCI card in the board Bamboo: classic frames, 1 Mbit/s. */
#include "can_controller.h"

/* On hardware the bridge needs a window to PCI memory at this address; QEMU has it open. */
enum { PCI_SLOT = 1, PCI_COMMAND = 0x04, MEMORY_ENABLE = 2, FIRST_SPACE = 0x10, SECOND_SPACE = 0x14 };
#define FIRST_SPACE_AT 0xA0010000u
#define CONTROLLER_AT 0xA0000000u /* the second space */
static volatile uint32_t *const pci_address = (volatile uint32_t *)0xEEC00000u;
static volatile uint32_t *const pci_data = (volatile uint32_t *)0xEEC00004u;

enum { MODE = 0x04, STATUS = 0x08, COMMAND = 0x0C, BIT_TIMING = 0x24, RECEIVE = 0x6C };
enum { TRANSMIT_STATUS = 0x70, TRANSMIT_COMMAND = 0x74, TRANSMIT_PRIORITY = 0x78, TRANSMIT = 0x100 };
enum { RESET = 0x1, ENABLE = 0x400000 };                       /* MODE */
enum { RECEIVED = 0x1, OVERRUN = 0x2, CLEAR_OVERRUN = 0x8 };   /* STATUS, COMMAND */
enum { STATES = 0xF, FIRST_IDLE = 4, SEND_FIRST = 0x102 };     /* TRANSMIT_STATUS, TRANSMIT_COMMAND */
enum { LENGTH = 0xF, NOT_CLASSIC_DATA = 0xE0, ID_SHIFT = 18 }; /* a frame: two words, its time in two, its data */

/* 20 quanta of 50 ns: 1, propagation 7, phases 8 and 4; jump width 2. */
static const uint32_t bit_timing = 7u | 8u << 7 | 4u << 13 | 5u << 19 | 2u << 27;

static uint32_t overruns;

/* The registers of controller and bridge are little-endian. */
static uint32_t get(uint32_t place) { return __builtin_bswap32(*(volatile uint32_t *)(CONTROLLER_AT + place)); }

static void set(uint32_t place, uint32_t value) {
    *(volatile uint32_t *)(CONTROLLER_AT + place) = __builtin_bswap32(value);
}

static void configure(uint32_t place, uint32_t value) {
    *pci_address = __builtin_bswap32(0x80000000u | (uint32_t)PCI_SLOT << 11 | place);
    *pci_data = __builtin_bswap32(value);
}

void can_start(void) {
    configure(FIRST_SPACE, FIRST_SPACE_AT);
    configure(SECOND_SPACE, CONTROLLER_AT);
    configure(PCI_COMMAND, MEMORY_ENABLE);
    set(MODE, RESET);
    set(BIT_TIMING, bit_timing);
    set(TRANSMIT_PRIORITY, 1u);
    set(MODE, ENABLE);
}

bool can_read(can_frame *frame) {
    const uint32_t status = get(STATUS);
    if ((status & OVERRUN) != 0u) {
        overruns++;
        set(COMMAND, CLEAR_OVERRUN);
    }
    if ((status & RECEIVED) == 0u)
        return false;
    const uint32_t form = get(RECEIVE), words = form >> 11 & 0x1Fu;
    frame->id = get(RECEIVE) >> ID_SHIFT & 0x7FFu;
    frame->length = form & LENGTH;
    for (uint32_t k = 2u; k <= words; k++) {
        const uint32_t word = get(RECEIVE);
        for (uint32_t byte = 0u; k >= 4u && k < 6u && byte < 4u; byte++)
            frame->data[4u * (k - 4u) + byte] = (uint8_t)(word >> 8u * byte);
    }
    return (form & NOT_CLASSIC_DATA) == 0u && frame->length <= sizeof frame->data;
}

bool can_write(const can_frame *frame) {
    const uint8_t *data = frame->data;
    if ((get(TRANSMIT_STATUS) & STATES) < FIRST_IDLE)
        return false;
    set(TRANSMIT, (uint32_t)frame->length);
    set(TRANSMIT + 4, (uint32_t)frame->id << ID_SHIFT);
    set(TRANSMIT + 8, 0u);
    set(TRANSMIT + 12, 0u);
    for (uint32_t k = 0u; k < sizeof frame->data; k += 4u, data += 4)
        set(TRANSMIT + 16 + k, data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 | (uint32_t)data[3] << 24);
    set(TRANSMIT_COMMAND, SEND_FIRST);
    return true;
}

uint32_t can_overruns(void) { return overruns; }

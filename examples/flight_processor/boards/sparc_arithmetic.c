/* Arithmetic of 64 bits that SPARC V8 has no instructions for, and that gcc takes from its library: Debian's gcc for SPARC has
 * none for V8. */
#include <stdint.h>

uint64_t __udivmod(uint64_t number, uint64_t by, uint64_t *rest);
uint64_t __udivdi3(uint64_t number, uint64_t by);
uint64_t __umoddi3(uint64_t number, uint64_t by);
uint64_t __muldi3(uint64_t a, uint64_t b);
uint64_t __ashldi3(uint64_t number, int bits);
uint64_t __lshrdi3(uint64_t number, int bits);
float __floatundisf(uint64_t number);
float __floatdisf(int64_t number);
uint64_t __fixunssfdi(float number);
int64_t __fixsfdi(float number);

typedef union {
    uint64_t whole;
    struct {
        uint32_t high, low;
    } half;
} parts;

uint64_t __ashldi3(uint64_t number, int bits) {
    parts word = {number};
    if (bits >= 32) {
        word.half.high = word.half.low << (bits - 32);
        word.half.low = 0u;
    } else if (bits > 0) {
        word.half.high = word.half.high << bits | word.half.low >> (32 - bits);
        word.half.low <<= bits;
    }
    return word.whole;
}

uint64_t __lshrdi3(uint64_t number, int bits) {
    parts word = {number};
    if (bits >= 32) {
        word.half.low = word.half.high >> (bits - 32);
        word.half.high = 0u;
    } else if (bits > 0) {
        word.half.low = word.half.low >> bits | word.half.high << (32 - bits);
        word.half.high >>= bits;
    }
    return word.whole;
}

uint64_t __muldi3(uint64_t a, uint64_t b) {
    uint64_t product = 0u;
    for (; b != 0u; b >>= 1, a += a)
        product += (b & 1u) != 0u ? a : 0u;
    return product;
}

uint64_t __udivmod(uint64_t number, uint64_t by, uint64_t *rest) {
    uint64_t quotient = 0u;
    *rest = 0u;
    for (int k = 0; k < 64; k++) {
        const uint64_t carry = *rest >> 63;
        *rest = *rest << 1 | number >> 63;
        number <<= 1;
        quotient <<= 1;
        if (carry != 0u || *rest >= by) {
            *rest -= by;
            quotient |= 1u;
        }
    }
    return quotient;
}

uint64_t __udivdi3(uint64_t number, uint64_t by) {
    uint64_t rest;
    return __udivmod(number, by, &rest);
}

uint64_t __umoddi3(uint64_t number, uint64_t by) {
    uint64_t rest;
    (void)__udivmod(number, by, &rest);
    return rest;
}

/* Numbers up to 2^32 have no rounding of their own: the fields of packets that become floats are no wider. */
float __floatundisf(uint64_t number) {
    const parts word = {number};
    const double high = (double)(int32_t)(word.half.high >> 1) * 2.0 + (double)(int32_t)(word.half.high & 1u);
    const double low = (double)(int32_t)(word.half.low >> 1) * 2.0 + (double)(int32_t)(word.half.low & 1u);
    return (float)(high * 4294967296.0 + low);
}

float __floatdisf(int64_t number) {
    return number < 0 ? -__floatundisf((uint64_t)-number) : __floatundisf((uint64_t)number);
}

/* For numbers below 2^62: steps of a field are below 2^33. */
uint64_t __fixunssfdi(float number) {
    const int32_t high = (int32_t)(number / 2147483648.0f);
    const int32_t low = (int32_t)(number - (float)high * 2147483648.0f);
    return ((uint64_t)(uint32_t)high << 31) + (uint32_t)low;
}

int64_t __fixsfdi(float number) {
    return number < 0.0f ? -(int64_t)__fixunssfdi(-number) : (int64_t)__fixunssfdi(number);
}

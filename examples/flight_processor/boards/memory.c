/* The functions that gcc asks of every freestanding environment. */
#include <stddef.h>

void *memcpy(void *to, const void *from, size_t count);
void *memmove(void *to, const void *from, size_t count);
void *memset(void *to, int value, size_t count);

void *memcpy(void *to, const void *from, size_t count) {
    for (size_t k = 0u; k < count; k++)
        ((unsigned char *)to)[k] = ((const unsigned char *)from)[k];
    return to;
}

void *memmove(void *to, const void *from, size_t count) {
    if ((const unsigned char *)from > (unsigned char *)to)
        return memcpy(to, from, count);
    while (count-- > 0u)
        ((unsigned char *)to)[count] = ((const unsigned char *)from)[count];
    return to;
}

void *memset(void *to, int value, size_t count) {
    for (size_t k = 0u; k < count; k++)
        ((unsigned char *)to)[k] = (unsigned char)value;
    return to;
}

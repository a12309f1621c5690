/* The core's two tanh in C, in place of the libraries': src/estimate/tanh.rs, a table of steps of 1/16 and a step of the
 * third order, and boards/dsp/src/tanh.rs in 16 bits, a table of values and slopes. Like the core's nets the first takes
 * finite numbers only. */

#ifndef TANH_H
#define TANH_H

#include <arm_acle.h>
#include <math.h>
#include <stdint.h>

enum { TANH_LAST = 127, TANH_WHOLE_BITS = 0x49000000 };

/* Offset that rounds to the nearest step: from 2^19 on, the lowest bits of a float count steps. */
#define TANH_MIDDLE (524288.0f + TANH_LAST / 16.0f)

static float tanh_table[2 * TANH_LAST + 2];

/* Values (upper half) and slopes in the middle of each step, by the bits of the argument: negative ones come last. */
static uint32_t tanh_table_16[512];

static void tanh_prepare(void)
{
    for (int i = 0; i < 256; i++) {
        double t = tanh((i + 0.5) / 32.0), g = 1.0 - t * t;
        uint32_t slope = (uint32_t)(g * 1024.0 + 0.5);
        double value = (t - t * g / 64.0 / 64.0 / 2.0) * 32768.0;
        int32_t up = value < 32767.0 ? (int32_t)(value + 1.0) : 32767;
        tanh_table_16[i] = (uint32_t)up << 16 | slope;
        tanh_table_16[511 - i] = (uint32_t)-(int32_t)value << 16 | slope;
    }
    for (int i = 0; i < TANH_LAST; i++) {
        tanh_table[TANH_LAST + i] = (float)tanh(i / 16.0);
        tanh_table[TANH_LAST - i] = -tanh_table[TANH_LAST + i];
    }
    tanh_table[0] = -1.0f;
    tanh_table[2 * TANH_LAST] = tanh_table[2 * TANH_LAST + 1] = 1.0f;
}

static inline float tanh_of_core(float x)
{
    float sum = x + TANH_MIDDLE;
    /* Keeps a compiler that may reorder sums from taking the offset off again. */
    __asm__("" : "+t"(sum));
    union { float number; int32_t bits; } as = { sum };
    float t = tanh_table[__usat(__qsub(as.bits, TANH_WHOLE_BITS), 8)];
    float d = x - (sum - TANH_MIDDLE);
    float dt = d * t;
    float dg = d - dt * t;
    float rest = 1.0f + ((2.0f / 3.0f * d - dg) * d - dt);
    return t + dg * rest;
}

/* Argument in eighths: 32768 is 8. */
static inline int16_t tanh_16_of_core(int32_t x)
{
    int32_t entry = (int32_t)tanh_table_16[x >> 7 & 511];
    int16_t from_middle = (int16_t)(x << 9 ^ 0x8000);
    return (int16_t)(__smlabb(entry, from_middle, entry) >> 16);
}

#endif

/* Nets of other libraries on the machine of host-tools/emulator: the 16-16-3 tanh net of [DeMaria2011] by each
 * library, with weights and inputs from the host. With CORE_TANH the libraries take the core's tanh in
 * place of theirs. `cargo run -p taxel-research -- peers` builds and runs it. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "arm_math.h"

#ifdef CORE_TANH
#include "tanh.h"
#define tanhf tanh_of_core
#define TANH_16(x) tanh_16_of_core(x)
#define NAME(library) library " with taxel's tanh"
#else
static void tanh_prepare(void) {}
#define TANH_16(x) arm_linear_interp_q15(tanh_16, ((x) + 32768) << 13, STEPS + 1)
#define NAME(library) library
#endif

#include "eml_net.h"

enum { INPUTS = 16, HIDDEN = 16, OUTPUTS = 3 };

/* Inputs in the layout that host-tools/emulator/src/peers.rs writes. */
struct given {
    uint32_t length;
    uint32_t count;
    float signal; /* 16-bit value of a signal of 1 */
    float hidden[HIDDEN * INPUTS];
    float hidden_bias[HIDDEN];
    float output[OUTPUTS * HIDDEN];
    float output_bias[OUTPUTS];
    float inputs[][INPUTS];
};
static const struct given *const given = (const struct given *)0x90000000;

/* emlearn: method "loadable", one row of weights per input. */
static float eml_hidden[INPUTS * HIDDEN], eml_output[HIDDEN * OUTPUTS], eml_buffers[2][HIDDEN];
static EmlNetLayer eml_layers[2] = {
    { HIDDEN, INPUTS, eml_hidden, 0, EmlNetActivationTanh },
    { OUTPUTS, HIDDEN, eml_output, 0, EmlNetActivationIdentity },
};
static EmlNet eml = { 2, eml_layers, eml_buffers[0], eml_buffers[1], HIDDEN };

static void emlearn(const float *x, float *y)
{
    eml_net_infer(&eml, x, INPUTS);
    for (int i = 0; i < OUTPUTS; i++) {
        y[i] = eml.activations2[i];
    }
}

/* CMSIS-DSP: its matrices and vectors, and the C library's tanhf, because it has none. */
static arm_matrix_instance_f32 dsp_hidden, dsp_output;

static void cmsis_dsp(const float *x, float *y)
{
    float units[HIDDEN];
    arm_mat_vec_mult_f32(&dsp_hidden, x, units);
    arm_add_f32(units, given->hidden_bias, units, HIDDEN);
    for (int i = 0; i < HIDDEN; i++) {
        units[i] = tanhf(units[i]);
    }
    arm_mat_vec_mult_f32(&dsp_output, units, y);
    arm_add_f32(y, given->output_bias, y, OUTPUTS);
}

/* CMSIS-DSP in 16 bits: arguments of tanh in eighths, tanh from a table of its interpolation. Its own functions
 * throughout, except the bias of the outputs, which is in floats in the core's net too. */
enum { STEPS = 512 };
static q15_t hidden_16[HIDDEN * INPUTS], hidden_bias_16[HIDDEN], output_16[OUTPUTS * HIDDEN], tanh_16[STEPS + 1];
static arm_matrix_instance_q15 dsp_hidden_16, dsp_output_16;
static float output_one;

static void cmsis_dsp_16(const float *x, float *y)
{
    float scaled[INPUTS];
    q15_t signals[INPUTS], units[HIDDEN], sums[OUTPUTS];
    arm_scale_f32(x, given->signal / 32768.0f, scaled, INPUTS);
    arm_float_to_q15(scaled, signals, INPUTS);
    arm_mat_vec_mult_q15(&dsp_hidden_16, signals, units);
    arm_add_q15(units, hidden_bias_16, units, HIDDEN);
    for (int i = 0; i < HIDDEN; i++) {
        units[i] = TANH_16(units[i]);
    }
    arm_mat_vec_mult_q15(&dsp_output_16, units, sums);
    arm_q15_to_float(sums, y, OUTPUTS);
    arm_scale_f32(y, output_one, y, OUTPUTS);
    arm_add_f32(y, given->output_bias, y, OUTPUTS);
}

static void end(uint32_t reason);

/* Number in 16 bits; ends the program if it does not fit. */
static q15_t narrowed(float x)
{
    float whole = roundf(x);
    if (!(fabsf(whole) <= 32767.0f)) {
        end(0x20024);
    }
    return (q15_t)whole;
}

static void prepare_16(void)
{
    for (int i = 0; i < HIDDEN * INPUTS; i++) {
        hidden_16[i] = narrowed(given->hidden[i] * 4096.0f * 32768.0f / given->signal);
    }
    float most = 0.0f;
    for (int o = 0; o < OUTPUTS; o++) {
        float sum = 0.0f;
        for (int h = 0; h < HIDDEN; h++) {
            sum += fabsf(given->output[o * HIDDEN + h]);
        }
        most = fmaxf(most, sum);
    }
    /* A little less than full scale, so that no rounding overflows. */
    output_one = most * 1.002f;
    for (int i = 0; i < OUTPUTS * HIDDEN; i++) {
        output_16[i] = narrowed(given->output[i] * 32768.0f / output_one);
    }
    for (int h = 0; h < HIDDEN; h++) {
        hidden_bias_16[h] = narrowed(given->hidden_bias[h] * 4096.0f);
    }
    for (int i = 0; i <= STEPS; i++) {
        tanh_16[i] = narrowed(32767.0f * (float)tanh((i - STEPS / 2) / 32.0));
    }
    arm_mat_init_q15(&dsp_hidden_16, HIDDEN, INPUTS, hidden_16);
    arm_mat_init_q15(&dsp_output_16, OUTPUTS, HIDDEN, output_16);
}

static void prepare(void)
{
    tanh_prepare();
    prepare_16();
    for (int i = 0; i < INPUTS; i++) {
        for (int h = 0; h < HIDDEN; h++) {
            eml_hidden[i * HIDDEN + h] = given->hidden[h * INPUTS + i];
        }
    }
    for (int h = 0; h < HIDDEN; h++) {
        for (int o = 0; o < OUTPUTS; o++) {
            eml_output[h * OUTPUTS + o] = given->output[o * HIDDEN + h];
        }
    }
    eml_layers[0].biases = given->hidden_bias;
    eml_layers[1].biases = given->output_bias;
    arm_mat_init_f32(&dsp_hidden, HIDDEN, INPUTS, (float *)given->hidden);
    arm_mat_init_f32(&dsp_output, OUTPUTS, HIDDEN, (float *)given->output);
}

/* Semihosting, with the operations of boards/cycles/src/host.rs. */
static void host(uint32_t operation, const void *parameter)
{
    register uint32_t r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = parameter;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
}

static void end(uint32_t reason)
{
    host(0x18, (const void *)reason);
    for (;;) {
    }
}

typedef void (*peer)(const float *, float *);

static void measure(const char *name, peer volatile run)
{
    for (uint32_t i = 0; i < given->count; i++) {
        float y[OUTPUTS];
        const uint32_t call[3] = { (uint32_t)run, (uint32_t)name, strlen(name) };
        host(0x100, call);
        run(given->inputs[i], y);
        const uint32_t result[2] = { (uint32_t)y, sizeof y };
        host(0x101, result);
    }
}

extern uint32_t data_from, data_begin, data_end, bss_begin, bss_end, stack_top;

void reset(void)
{
    *(volatile uint32_t *)0xe000ed88 |= 0xf << 20; /* the floating-point unit */
    __asm__ volatile("dsb\n\tisb");
    memcpy(&data_begin, &data_from, (char *)&data_end - (char *)&data_begin);
    memset(&bss_begin, 0, (char *)&bss_end - (char *)&bss_begin);
    prepare();
    measure(NAME("emlearn"), emlearn);
    measure(NAME("CMSIS-DSP"), cmsis_dsp);
    measure(NAME("CMSIS-DSP q15"), cmsis_dsp_16);
    end(0x20026);
}

__attribute__((section(".vectors"), used)) static const void *const vectors[2] = { &stack_top, reset };

/* tanhf sets errno if the C library is configured so. */
int *__errno(void)
{
    static int number;
    return &number;
}

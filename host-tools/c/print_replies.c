/* Prints each reply of a stream on standard input as a line. Build: cc -std=c99 print_replies.c */
#include <inttypes.h>
#include <stdio.h>

#include "taxel_command.h"

static void print_channel(const char *name, int i, struct taxel_channel channel) {
    if (channel.present) printf(" %s%d=%.9g/%.9g", name, i, (double)channel.mean, (double)channel.noise);
}

static void print_self_test(const struct taxel_self_test *test) {
    printf("self-test scans=%u full_scale=%" PRId32 " record_intact=%d", test->scans, test->full_scale, test->record_intact);
    for (int k = 0; k < TAXEL_TAXELS; k++) print_channel("lit", k, test->lit[k]);
    for (int c = 0; c < 4; c++) print_channel("dark", c, test->dark[c]);
    for (int m = 0; m < 4 * TAXEL_SENSORS; m++) print_channel("bridge", m, test->bridges[m / 4][m % 4]);
    print_channel("reference", 0, test->reference);
    print_channel("temperature", 0, test->temperature);
}

static void print_bias(const struct taxel_bias *bias) {
    printf("bias on_command=%u in_contact=%u", bias->on_command, bias->in_contact);
    if (bias->has_taxels) {
        for (int k = 0; k < TAXEL_TAXELS; k++) printf(" c%d=%.9g", k, (double)bias->taxels[k]);
        printf(" noise=%.9g", (double)bias->taxel_noise);
    }
    for (int s = 0; s < TAXEL_SENSORS; s++)
        if (bias->has_bridge[s]) {
            for (int axis = 0; axis < 3; axis++) printf(" s%d_%d=%.9g", s, axis, (double)bias->bridges[s][axis]);
            printf(" s%d_noise=%.9g", s, (double)bias->bridge_noise[s]);
        }
}

static void print_info(const struct taxel_info *info) {
    printf("info board=%s serial=%s build=%s scan_hz=%u full_scale=%" PRId32, info->board, info->serial, info->build, info->scan_hz, info->full_scale);
    printf(" rate_millihertz=%" PRIu32 " fields=%u streaming=%u biased=%u", info->rate_millihertz, info->fields, info->streaming, info->biased);
    if (info->calibrated) printf(" calibration=%s", info->calibration_serial);
    printf(" scans=%" PRIu32 " frames=%" PRIu32 " lost=%" PRIu32 " overruns=%" PRIu32, info->scans, info->frames, info->lost, info->overruns);
    printf(" bad_packets=%" PRIu32 " filter_hz=%u", info->bad_packets, info->filter_hz);
}

static void print(const struct taxel_reply *reply) {
    const uint8_t *firmware = reply->as.version.firmware;
    printf("tag=%u ", reply->tag);
    switch (reply->kind) {
    case TAXEL_REPLY_VERSION:
        printf("version protocol=%u firmware=%u.%u.%u", reply->as.version.protocol, firmware[0], firmware[1], firmware[2]);
        break;
    case TAXEL_REPLY_INFO: print_info(&reply->as.info); break;
    case TAXEL_REPLY_RATE: printf("rate millihertz=%" PRIu32, reply->as.rate_millihertz); break;
    case TAXEL_REPLY_BIAS: print_bias(&reply->as.bias); break;
    case TAXEL_REPLY_SELF_TEST: print_self_test(&reply->as.self_test); break;
    case TAXEL_REPLY_REFUSED:
        printf("%s low=%" PRIu32 " high=%" PRIu32, taxel_reply_text(reply), reply->as.refusal.low, reply->as.refusal.high);
        break;
    default: printf("%s", taxel_reply_text(reply));
    }
    putchar('\n');
}

int main(void) {
    uint8_t packet[TAXEL_MAX_PACKET], message[TAXEL_MAX_PACKET];
    struct taxel_reply reply;
    size_t length = 0;
    for (int byte; (byte = getchar()) != EOF;) {
        if (byte != 0) {
            if (length < sizeof packet) packet[length] = (uint8_t)byte;
            length++;
            continue;
        }
        size_t size = taxel_unpack(packet, length, message);
        length = 0;
        if (size && taxel_reply_decode(message, size, &reply)) print(&reply);
    }
    return 0;
}

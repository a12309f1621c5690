/* Prints the frames of a stream from standard input, a line each. Build: cc -std=c99 print_frames.c */
#include <inttypes.h>
#include <stdio.h>

#include "taxel_frame.h"

static void print(const char *name, struct taxel_value value) {
    if (taxel_given(value)) printf(" %s=%.9g", name, (double)value.value);
    else if (value.why != TAXEL_NOT_SENT) printf(" %s=!%d", name, value.why);
}

int main(void) {
    uint8_t packet[TAXEL_MAX_PACKET], message[TAXEL_MAX_PACKET];
    size_t length = 0;
    for (int byte; (byte = getchar()) != EOF;) {
        if (byte != 0) {
            if (length < sizeof packet) packet[length] = (uint8_t)byte;
            length++;
            continue;
        }
        size_t size = taxel_unpack(packet, length, message);
        struct taxel_frame frame;
        length = 0;
        if (!size || !taxel_frame_decode(message, size, &frame)) continue;
        printf("seq=%" PRIu32 " time_us=%" PRIu64 " status=%" PRIu32, frame.seq, frame.time_us, frame.status);
        if (frame.has_codes) {
            const struct taxel_codes *c = &frame.codes;
            printf(" full_scale=%" PRId32 " lit0=%" PRId32 " lit15=%" PRId32 " dark3=%" PRId32, c->full_scale, c->lit[0], c->lit[15], c->dark[3]);
            printf(" bridge0d=%" PRId32 " bridge3a=%" PRId32 " reference=%" PRId32 " temperature=%" PRId32, c->bridges[0][3], c->bridges[3][0], c->reference, c->temperature);
        }
        if (frame.has_signals) {
            const struct taxel_signals *s = &frame.signals;
            if (s->has_taxels) printf(" c0=%.9g c15=%.9g", (double)s->taxels[0], (double)s->taxels[15]);
            if (s->has_bridge[0]) printf(" u0z=%.9g", (double)s->bridges[0][2]);
            printf(" saturated=%u dead=%u bridge_faults=%u", s->saturated, s->dead, s->bridge_faults);
        }
        print("s0x", frame.sensors[0][0]);
        print("s3z", frame.sensors[3][2]);
        print("fx", frame.force[0]);
        print("fy", frame.force[1]);
        print("fz", frame.force[2]);
        print("x", frame.point[0]);
        print("y", frame.point[1]);
        print("margin", frame.slip[0]);
        print("grip", frame.slip[2]);
        print("torsion", frame.torsion);
        print("contact1y", frame.contacts[0][1]);
        print("contact2fz", frame.contacts[1][2]);
        print("fx_sigma", frame.force_sigma[0]);
        print("fz_sigma", frame.force_sigma[2]);
        print("y_sigma", frame.point_sigma[1]);
        print("misfit", frame.misfit);
        putchar('\n');
    }
    return 0;
}

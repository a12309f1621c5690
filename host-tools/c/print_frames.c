/* Prints each frame of a stream on standard input as a line. Build: cc -std=c99 print_frames.c */
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
        /* schema: values (from src/frame/schema.rs by `cargo xtask protocol`) */
        print("s0_fx_n", frame.sensors[0][0]);
        print("s0_fy_n", frame.sensors[0][1]);
        print("s0_fz_n", frame.sensors[0][2]);
        print("s1_fx_n", frame.sensors[1][0]);
        print("s1_fy_n", frame.sensors[1][1]);
        print("s1_fz_n", frame.sensors[1][2]);
        print("s2_fx_n", frame.sensors[2][0]);
        print("s2_fy_n", frame.sensors[2][1]);
        print("s2_fz_n", frame.sensors[2][2]);
        print("s3_fx_n", frame.sensors[3][0]);
        print("s3_fy_n", frame.sensors[3][1]);
        print("s3_fz_n", frame.sensors[3][2]);
        print("fx_n", frame.force[0]);
        print("fy_n", frame.force[1]);
        print("fz_n", frame.force[2]);
        print("x_mm", frame.point[0]);
        print("y_mm", frame.point[1]);
        print("slip_margin", frame.slip[0]);
        print("friction", frame.slip[1]);
        print("grip_n", frame.slip[2]);
        print("torsion_nmm", frame.torsion);
        print("contact1_x_mm", frame.contacts[0][0]);
        print("contact1_y_mm", frame.contacts[0][1]);
        print("contact1_fz_n", frame.contacts[0][2]);
        print("contact2_x_mm", frame.contacts[1][0]);
        print("contact2_y_mm", frame.contacts[1][1]);
        print("contact2_fz_n", frame.contacts[1][2]);
        print("fx_sigma_n", frame.force_sigma[0]);
        print("fy_sigma_n", frame.force_sigma[1]);
        print("fz_sigma_n", frame.force_sigma[2]);
        print("x_sigma_mm", frame.point_sigma[0]);
        print("y_sigma_mm", frame.point_sigma[1]);
        print("misfit", frame.misfit);
        /* schema: end */
        putchar('\n');
    }
    return 0;
}

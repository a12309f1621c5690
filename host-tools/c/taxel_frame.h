/* Frames of a taxel finger, in C99: from the packets of docs/protocol.md to a struct.
 *
 * No allocation, no globals, no undefined behaviour on any input. It takes whole packets: the bytes between
 * two zeros of the stream.
 *
 *     uint8_t message[TAXEL_MAX_PACKET];
 *     size_t length = taxel_unpack(packet, packet_length, message);
 *     struct taxel_frame frame;
 *     if (length && taxel_frame_decode(message, length, &frame) && taxel_given(frame.force[2]))
 *         use(frame.force[2].value);
 *
 * Fields of a later firmware are left unread; fields that an earlier one does not send are absent.
 */
#ifndef TAXEL_FRAME_H
#define TAXEL_FRAME_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define TAXEL_MAX_PACKET 448
#define TAXEL_TAXELS 16
#define TAXEL_SENSORS 4

/* Reasons for a missing value, with their numbers on the wire. */
enum taxel_why {
    TAXEL_GIVEN = -1,      /* the value is there */
    TAXEL_UNCALIBRATED = 0,
    TAXEL_NO_CONTACT,
    TAXEL_SATURATED,
    TAXEL_DEAD_CHANNEL,
    TAXEL_OUT_OF_TRAINED_RANGE,
    TAXEL_ILL_CONDITIONED,
    TAXEL_ABSENT,
    TAXEL_NOT_ESTIMATED,
    TAXEL_NOT_SENT = 127   /* the frame does not carry the field */
};

/* Bits of `status`. */
/* schema: status (from src/frame/schema.rs by `cargo xtask protocol`) */
#define TAXEL_STATUS_CONTACT (UINT32_C(1) << 0)
#define TAXEL_STATUS_UNCALIBRATED (UINT32_C(1) << 1)
#define TAXEL_STATUS_SATURATED (UINT32_C(1) << 2)
#define TAXEL_STATUS_DEAD_TAXEL (UINT32_C(1) << 3)
#define TAXEL_STATUS_BRIDGE_FAULT (UINT32_C(1) << 4)
#define TAXEL_STATUS_OUT_OF_RANGE (UINT32_C(1) << 5)
#define TAXEL_STATUS_OVERRUN (UINT32_C(1) << 6)
#define TAXEL_STATUS_BIASED (UINT32_C(1) << 7)
#define TAXEL_STATUS_STUCK_CHANNEL (UINT32_C(1) << 8)
#define TAXEL_STATUS_NOT_SINGLE (UINT32_C(1) << 9)
#define TAXEL_STATUS_DISAGREE (UINT32_C(1) << 10)
#define TAXEL_STATUS_SLIP_WARNING (UINT32_C(1) << 11)
#define TAXEL_STATUS_SLIDES (UINT32_C(1) << 12)
#define TAXEL_STATUS_TEMPERATURE (UINT32_C(1) << 13)
#define TAXEL_STATUS_NOISY (UINT32_C(1) << 14)
#define TAXEL_STATUS_ROW_HELD (UINT32_C(1) << 15)
#define TAXEL_STATUS_RAN_ARG_MIN (UINT32_C(1) << 16)
#define TAXEL_STATUS_RAN_CENTROID (UINT32_C(1) << 17)
#define TAXEL_STATUS_RAN_NET (UINT32_C(1) << 18)
#define TAXEL_STATUS_RAN_SENSORS (UINT32_C(1) << 19)
#define TAXEL_STATUS_RAN_MODEL (UINT32_C(1) << 20)
#define TAXEL_STATUS_RAN_SHEAR (UINT32_C(1) << 21)
#define TAXEL_STATUS_RAN_PAIR (UINT32_C(1) << 22)
#define TAXEL_STATUS_RAN_ARRAY (UINT32_C(1) << 23)
#define TAXEL_STATUS_RAN_SLIP (UINT32_C(1) << 24)
#define TAXEL_STATUS_RAN_QUANTISED (UINT32_C(1) << 25)
#define TAXEL_STATUS_RAN_WARMTH (UINT32_C(1) << 26)
#define TAXEL_STATUS_RAN_LAG (UINT32_C(1) << 27)
#define TAXEL_STATUS_RAN_DRIFT (UINT32_C(1) << 28)
/* schema: end */

/* A measured value; `value` is 0 where it is not given. */
struct taxel_value {
    int8_t why;
    float value;
};

/* ADC codes; a missing channel is -1. */
struct taxel_codes {
    int32_t full_scale;
    int32_t lit[TAXEL_TAXELS], dark[4];
    int32_t bridges[TAXEL_SENSORS][4];
    int32_t reference, temperature;
};

/* Conditioned signals as shares of full scale. */
struct taxel_signals {
    uint8_t has_taxels, has_bridge[TAXEL_SENSORS];
    float taxels[TAXEL_TAXELS], bridges[TAXEL_SENSORS][3];
    uint16_t saturated, dead;
    uint8_t bridge_faults;
};

struct taxel_frame {
    uint32_t seq;
    uint64_t time_us;
    uint32_t status;
    /* schema: members (a value for each column, unit in its name) */
    uint8_t has_codes;
    struct taxel_codes codes;
    uint8_t has_signals;
    struct taxel_signals signals;
    struct taxel_value sensors[4][3]; /* s0_fx_n ... s3_fz_n */
    struct taxel_value force[3]; /* fx_n fy_n fz_n */
    struct taxel_value point[2]; /* x_mm y_mm */
    struct taxel_value slip[3]; /* slip_margin friction grip_n */
    struct taxel_value torsion; /* torsion_nmm */
    struct taxel_value contacts[2][3]; /* contact1_x_mm ... contact2_fz_n */
    struct taxel_value force_sigma[3]; /* fx_sigma_n fy_sigma_n fz_sigma_n */
    struct taxel_value point_sigma[2]; /* x_sigma_mm y_sigma_mm */
    struct taxel_value misfit; /* misfit */
    /* schema: end */
};

static inline int taxel_given(struct taxel_value value) { return value.why == TAXEL_GIVEN; }

/* Says in words why a value is missing. */
static inline const char *taxel_why_text(int why) {
    static const char *const texts[] = {
        "uncalibrated", "no contact", "saturated", "dead channel",
        "out of trained range", "ill-conditioned", "absent", "not estimated",
    };
    if (why == TAXEL_GIVEN) return "given";
    if (why == TAXEL_NOT_SENT) return "not sent";
    return why >= 0 && why <= TAXEL_NOT_ESTIMATED ? texts[why] : "a reason of a later firmware";
}

/* CRC-32/ISO-HDLC, as in zip. */
static inline uint32_t taxel_crc32(const uint8_t *bytes, size_t length) {
    uint32_t crc = UINT32_C(0xffffffff);
    for (size_t i = 0; i < length; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (UINT32_C(0xedb88320) & (0u - (crc & 1u)));
    }
    return ~crc;
}

/* Decodes COBS and checks the CRC. Returns the length of the message, or 0 for an invalid packet. */
static inline size_t taxel_unpack(const uint8_t *packet, size_t length, uint8_t message[TAXEL_MAX_PACKET]) {
    size_t in = 0, out = 0;
    if (length > TAXEL_MAX_PACKET) return 0;
    while (in < length) {
        uint8_t code = packet[in++];
        if (code == 0 || (size_t)(code - 1) > length - in) return 0;
        for (uint8_t i = 1; i < code; i++) message[out++] = packet[in++];
        if (code != 0xff && in < length) message[out++] = 0;
    }
    if (out < 5) return 0;
    uint32_t sent = 0;
    for (int i = 3; i >= 0; i--) sent = sent << 8 | message[out - 4 + (size_t)i];
    return taxel_crc32(message, out - 4) == sent ? out - 4 : 0;
}

struct taxel_reader {
    const uint8_t *at, *end;
    int ok;
};

static inline uint8_t taxel_byte(struct taxel_reader *r) {
    if (r->at == r->end) {
        r->ok = 0;
        return 0;
    }
    return *r->at++;
}

static inline uint64_t taxel_varint(struct taxel_reader *r) {
    uint64_t value = 0;
    for (unsigned shift = 0; shift < 64; shift += 7) {
        uint8_t byte = taxel_byte(r);
        value |= (uint64_t)(byte & 0x7f) << shift;
        if (!(byte & 0x80)) return value;
    }
    r->ok = 0;
    return 0;
}

static inline int32_t taxel_code(struct taxel_reader *r) {
    int32_t low = taxel_byte(r);
    return low | (int32_t)taxel_byte(r) << 8;
}

static inline float taxel_float(struct taxel_reader *r) {
    uint32_t bits = 0;
    for (unsigned i = 0; i < 4; i++) bits |= (uint32_t)taxel_byte(r) << (8 * i);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Reads the first byte of an option or a result: 0 or 1. */
static inline int taxel_choice(struct taxel_reader *r) {
    uint8_t byte = taxel_byte(r);
    if (byte > 1) r->ok = 0;
    return byte == 1;
}

/* Returns whether the next field is present; a message that has ended holds none. */
static inline int taxel_field(struct taxel_reader *r) { return r->at != r->end && taxel_choice(r); }

/* Reads values, each with its own reason if missing. */
static inline void taxel_each(struct taxel_reader *r, struct taxel_value *values, int count) {
    for (int i = 0; i < count; i++) {
        values[i].why = TAXEL_GIVEN;
        if (taxel_choice(r)) values[i].why = (int8_t)(taxel_byte(r) & 0x7f);
        else values[i].value = taxel_float(r);
    }
}

static inline void taxel_withheld(struct taxel_value *values, int count, int8_t why) {
    for (int i = 0; i < count; i++) values[i].why = why;
}

/* Reads values that share one reason if missing. */
static inline void taxel_values(struct taxel_reader *r, struct taxel_value *values, int count) {
    int withheld = taxel_choice(r);
    int8_t why = withheld ? (int8_t)(taxel_byte(r) & 0x7f) : (int8_t)TAXEL_GIVEN;
    for (int i = 0; i < count; i++) {
        values[i].why = why;
        if (!withheld) values[i].value = taxel_float(r);
    }
}

/* schema: parts */
static inline void taxel_decode_uncertainty(struct taxel_reader *r, struct taxel_frame *frame) {
    if (taxel_choice(r)) {
        int8_t why = (int8_t)(taxel_byte(r) & 0x7f);
        taxel_withheld(frame->force_sigma, 3, why);
        taxel_withheld(frame->point_sigma, 2, why);
        taxel_withheld(&frame->misfit, 1, why);
        return;
    }
    taxel_each(r, frame->force_sigma, 3);
    taxel_values(r, frame->point_sigma, 2);
    taxel_values(r, &frame->misfit, 1);
}
/* schema: end */

static inline void taxel_decode_codes(struct taxel_reader *r, struct taxel_codes *codes) {
    memset(codes, 0xff, sizeof *codes); /* every code is -1 */
    codes->full_scale = taxel_code(r);
    if (taxel_choice(r)) {
        for (int k = 0; k < TAXEL_TAXELS; k++) codes->lit[k] = taxel_code(r);
        for (int c = 0; c < 4; c++) codes->dark[c] = taxel_code(r);
    }
    for (int s = 0; s < TAXEL_SENSORS; s++)
        if (taxel_choice(r))
            for (int m = 0; m < 4; m++) codes->bridges[s][m] = taxel_code(r);
    if (taxel_choice(r)) codes->reference = taxel_code(r);
    if (taxel_choice(r)) codes->temperature = taxel_code(r);
}

static inline void taxel_decode_signals(struct taxel_reader *r, struct taxel_signals *signals) {
    signals->has_taxels = (uint8_t)taxel_choice(r);
    if (signals->has_taxels)
        for (int k = 0; k < TAXEL_TAXELS; k++) signals->taxels[k] = taxel_float(r);
    for (int s = 0; s < TAXEL_SENSORS; s++) {
        signals->has_bridge[s] = (uint8_t)taxel_choice(r);
        if (signals->has_bridge[s])
            for (int axis = 0; axis < 3; axis++) signals->bridges[s][axis] = taxel_float(r);
    }
    signals->saturated = (uint16_t)taxel_varint(r);
    signals->dead = (uint16_t)taxel_varint(r);
    signals->bridge_faults = taxel_byte(r);
}

/* Decodes a message. Returns 1 for a frame, 0 for anything else. */
static inline int taxel_frame_decode(const uint8_t *message, size_t length, struct taxel_frame *frame) {
    struct taxel_reader r = {message, message + length, 1};
    memset(frame, 0, sizeof *frame);
    /* schema: absent */
    taxel_withheld(frame->sensors[0], 12, TAXEL_NOT_SENT);
    taxel_withheld(frame->force, 3, TAXEL_NOT_SENT);
    taxel_withheld(frame->point, 2, TAXEL_NOT_SENT);
    taxel_withheld(frame->slip, 3, TAXEL_NOT_SENT);
    taxel_withheld(&frame->torsion, 1, TAXEL_NOT_SENT);
    taxel_withheld(frame->contacts[0], 6, TAXEL_NOT_SENT);
    taxel_withheld(frame->force_sigma, 3, TAXEL_NOT_SENT);
    taxel_withheld(frame->point_sigma, 2, TAXEL_NOT_SENT);
    taxel_withheld(&frame->misfit, 1, TAXEL_NOT_SENT);
    /* schema: end */
    if (taxel_varint(&r) != 2) return 0; /* another message */
    frame->seq = (uint32_t)taxel_varint(&r);
    frame->time_us = taxel_varint(&r);
    frame->status = (uint32_t)taxel_varint(&r);
    /* schema: fields */
    if ((frame->has_codes = (uint8_t)taxel_field(&r))) taxel_decode_codes(&r, &frame->codes);
    if ((frame->has_signals = (uint8_t)taxel_field(&r))) taxel_decode_signals(&r, &frame->signals);
    if (taxel_field(&r)) taxel_each(&r, frame->sensors[0], 12);
    if (taxel_field(&r)) taxel_each(&r, frame->force, 3);
    if (taxel_field(&r)) taxel_values(&r, frame->point, 2);
    if (taxel_field(&r)) taxel_values(&r, frame->slip, 3);
    if (taxel_field(&r)) taxel_values(&r, &frame->torsion, 1);
    if (taxel_field(&r)) taxel_values(&r, frame->contacts[0], 6);
    if (taxel_field(&r)) taxel_decode_uncertainty(&r, frame);
    /* schema: end */
    return r.ok;
}

#endif

/* Commands of a taxel finger, in C99: requests as packets of docs/protocol.md, and replies as structs.
 *
 * No allocation, no globals, no undefined behaviour on any input. Sending and receiving is the program's:
 *
 *     uint8_t packet[TAXEL_MAX_PACKET];
 *     size_t length = taxel_request(TAXEL_SET_RATE, 1000, tag, packet);
 *     write(port, packet, length);
 *     ...
 *     struct taxel_reply reply;
 *     if (taxel_reply_decode(message, message_length, &reply) && reply.tag == tag)
 *         puts(taxel_reply_text(&reply));
 *
 * Ask again after 0.5 s without a reply and give up after 2 s; TAXEL_TAKE_BIAS and TAXEL_SELF_TEST reply when
 * they are done. Uploads of calibrations, health and the scan's settings are left to `taxel`.
 */
#ifndef TAXEL_COMMAND_H
#define TAXEL_COMMAND_H

#include "taxel_frame.h"

#define TAXEL_PROTOCOL 2
#define TAXEL_MAX_TEXT 64

/* Commands, with their numbers on the wire, and the meaning of their argument. */
enum taxel_command {
    TAXEL_VERSION = 0,      /* none */
    TAXEL_INFO = 1,         /* none */
    TAXEL_STREAM = 2,       /* 1 starts, 0 stops */
    TAXEL_SET_RATE = 3,     /* frames per second */
    TAXEL_SET_FIELDS = 4,   /* mask of TAXEL_FIELD_... */
    TAXEL_TAKE_BIAS = 6,    /* number of scans; this is what others call tare */
    TAXEL_READ_BIAS = 7,    /* none */
    TAXEL_CLEAR_BIAS = 8,   /* none */
    TAXEL_SAVE_SETTINGS = 13, /* none */
    TAXEL_SAVE_BIAS = 14,   /* none */
    TAXEL_SELF_TEST = 16,   /* number of scans, at most 4096 */
    TAXEL_SET_FILTER = 19   /* corner in Hz, 0 is no filter */
};

/* Fields of a frame, for the mask of TAXEL_SET_FIELDS. */
enum taxel_field {
    TAXEL_FIELD_CODES = 1 << 0,
    TAXEL_FIELD_SIGNALS = 1 << 1,
    TAXEL_FIELD_SENSORS = 1 << 2,
    TAXEL_FIELD_FORCE = 1 << 3,
    TAXEL_FIELD_POINT = 1 << 4,
    TAXEL_FIELD_SLIP = 1 << 5,
    TAXEL_FIELD_TORSION = 1 << 6,
    TAXEL_FIELD_CONTACTS = 1 << 7,
    TAXEL_FIELD_UNCERTAINTY = 1 << 8
};

enum taxel_reply_kind {
    TAXEL_REPLY_DONE,
    TAXEL_REPLY_INFO,
    TAXEL_REPLY_RATE,
    TAXEL_REPLY_BIAS,
    TAXEL_REPLY_CALIBRATION, /* not decoded */
    TAXEL_REPLY_HEALTH,      /* not decoded */
    TAXEL_REPLY_SELF_TEST,
    TAXEL_REPLY_VERSION = 100,
    TAXEL_REPLY_REFUSED
};

struct taxel_version {
    uint16_t protocol;
    uint8_t firmware[3];
};

/* Identity and settings; texts longer than TAXEL_MAX_TEXT - 1 bytes are cut off. */
struct taxel_info {
    char board[TAXEL_MAX_TEXT], serial[TAXEL_MAX_TEXT], build[TAXEL_MAX_TEXT];
    uint16_t scan_hz;
    int32_t full_scale;
    uint32_t rate_millihertz;
    uint16_t fields;
    uint8_t streaming, biased, calibrated;
    char calibration_serial[TAXEL_MAX_TEXT];
    uint32_t scans, frames, lost, overruns, bad_packets;
    uint16_t filter_hz;
};

/* Levels and noise of the unloaded finger, as shares of full scale. */
struct taxel_bias {
    uint8_t has_taxels, has_bridge[TAXEL_SENSORS];
    float taxels[TAXEL_TAXELS], taxel_noise;
    float bridges[TAXEL_SENSORS][3], bridge_noise[TAXEL_SENSORS];
    uint8_t on_command, in_contact;
};

/* A channel's codes during a self-test; noise is their standard deviation. */
struct taxel_channel {
    uint8_t present;
    float mean, noise;
};

struct taxel_self_test {
    uint16_t scans;
    int32_t full_scale;
    struct taxel_channel lit[TAXEL_TAXELS], dark[4], bridges[TAXEL_SENSORS][4], reference, temperature;
    int8_t record_intact; /* -1 without a calibration record */
};

/* A refusal: its number on the wire and what it may be. */
struct taxel_refusal {
    uint32_t number, low, high;
};

struct taxel_reply {
    uint8_t tag;
    enum taxel_reply_kind kind;
    union {
        struct taxel_version version;
        struct taxel_info info;
        uint32_t rate_millihertz;
        struct taxel_bias bias;
        struct taxel_self_test self_test;
        struct taxel_refusal refusal;
    } as;
};

/* Encodes a message as a packet, with its final zero. Returns its length, or 0 if it is too long. */
static inline size_t taxel_pack(const uint8_t *message, size_t length, uint8_t packet[TAXEL_MAX_PACKET]) {
    if (length > TAXEL_MAX_PACKET - 8) return 0;
    uint32_t crc = taxel_crc32(message, length);
    size_t at = 1, code = 0;
    for (size_t i = 0; i < length + 4; i++) {
        uint8_t byte = (uint8_t)(i < length ? message[i] : crc >> (8 * (i - length)));
        if (byte != 0) packet[at++] = byte;
        if (byte == 0 || at - code == 0xff) {
            packet[code] = (uint8_t)(at - code);
            code = at++;
        }
    }
    packet[code] = (uint8_t)(at - code);
    packet[at++] = 0;
    return at;
}

/* Encodes a request; its reply repeats the tag. Returns the packet's length. */
static inline size_t taxel_request(enum taxel_command command, uint16_t argument, uint8_t tag,
                                   uint8_t packet[TAXEL_MAX_PACKET]) {
    uint8_t message[5] = {tag, (uint8_t)command};
    size_t length = 2;
    switch (command) {
    case TAXEL_STREAM:
    case TAXEL_SET_RATE:
    case TAXEL_SET_FIELDS:
    case TAXEL_TAKE_BIAS:
    case TAXEL_SELF_TEST:
    case TAXEL_SET_FILTER:
        for (; argument >= 0x80; argument = (uint16_t)(argument >> 7)) message[length++] = (uint8_t)(argument | 0x80);
        message[length++] = (uint8_t)argument;
        break;
    default: break;
    }
    return taxel_pack(message, length, packet);
}

static inline void taxel_text(struct taxel_reader *r, char text[TAXEL_MAX_TEXT]) {
    uint64_t length = taxel_varint(r);
    size_t kept = 0;
    for (uint64_t i = 0; i < length && r->ok; i++) {
        uint8_t byte = taxel_byte(r);
        if (kept < TAXEL_MAX_TEXT - 1) text[kept++] = (char)byte;
    }
    text[kept] = 0;
}

static inline void taxel_decode_info(struct taxel_reader *r, struct taxel_info *info) {
    taxel_text(r, info->board);
    taxel_text(r, info->serial);
    taxel_text(r, info->build);
    info->scan_hz = (uint16_t)taxel_varint(r);
    info->full_scale = taxel_code(r);
    taxel_varint(r); /* tick_hz */
    info->rate_millihertz = (uint32_t)taxel_varint(r);
    info->fields = (uint16_t)taxel_varint(r);
    info->streaming = (uint8_t)taxel_choice(r);
    taxel_varint(r); /* point_method */
    info->biased = (uint8_t)taxel_choice(r);
    info->calibrated = (uint8_t)taxel_choice(r);
    if (info->calibrated) {
        taxel_text(r, info->calibration_serial);
        taxel_varint(r); /* date */
        taxel_varint(r); /* crc */
    }
    info->scans = (uint32_t)taxel_varint(r);
    info->frames = (uint32_t)taxel_varint(r);
    info->lost = (uint32_t)taxel_varint(r);
    info->overruns = (uint32_t)taxel_varint(r);
    info->bad_packets = (uint32_t)taxel_varint(r);
    for (int i = 0; i < 4; i++) taxel_varint(r); /* lost_replies, cost_last, cost_worst, estimators */
    info->filter_hz = (uint16_t)taxel_varint(r);
}

static inline void taxel_decode_bias(struct taxel_reader *r, struct taxel_bias *bias) {
    bias->has_taxels = (uint8_t)taxel_choice(r);
    if (bias->has_taxels) {
        for (int k = 0; k < TAXEL_TAXELS; k++) bias->taxels[k] = taxel_float(r);
        bias->taxel_noise = taxel_float(r);
    }
    for (int s = 0; s < TAXEL_SENSORS; s++) {
        bias->has_bridge[s] = (uint8_t)taxel_choice(r);
        if (!bias->has_bridge[s]) continue;
        for (int axis = 0; axis < 3; axis++) bias->bridges[s][axis] = taxel_float(r);
        bias->bridge_noise[s] = taxel_float(r);
    }
    bias->on_command = (uint8_t)taxel_choice(r);
    bias->in_contact = (uint8_t)taxel_choice(r);
}

static inline void taxel_decode_channels(struct taxel_reader *r, struct taxel_channel *channels, int count) {
    for (int i = 0; i < count; i++) {
        channels[i].present = (uint8_t)taxel_choice(r);
        if (!channels[i].present) continue;
        channels[i].mean = taxel_float(r);
        channels[i].noise = taxel_float(r);
    }
}

static inline void taxel_decode_self_test(struct taxel_reader *r, struct taxel_self_test *test) {
    test->scans = (uint16_t)taxel_varint(r);
    test->full_scale = taxel_code(r);
    taxel_decode_channels(r, test->lit, TAXEL_TAXELS);
    taxel_decode_channels(r, test->dark, 4);
    for (int s = 0; s < TAXEL_SENSORS; s++) taxel_decode_channels(r, test->bridges[s], 4);
    taxel_decode_channels(r, &test->reference, 1);
    taxel_decode_channels(r, &test->temperature, 1);
    test->record_intact = taxel_choice(r) ? (int8_t)taxel_choice(r) : (int8_t)-1;
}

static inline void taxel_decode_refusal(struct taxel_reader *r, struct taxel_refusal *refusal) {
    refusal->number = (uint32_t)taxel_varint(r);
    if (refusal->number == 9) taxel_varint(r); /* the setting of the scan */
    if (refusal->number == 0 || refusal->number == 9) {
        refusal->low = (uint32_t)taxel_varint(r);
        refusal->high = (uint32_t)taxel_varint(r);
    }
}

/* Decodes a message. Returns 1 for a reply, 0 for a frame and anything else. */
static inline int taxel_reply_decode(const uint8_t *message, size_t length, struct taxel_reply *reply) {
    struct taxel_reader r = {message, message + length, 1};
    memset(reply, 0, sizeof *reply);
    uint64_t kind = taxel_varint(&r);
    if (kind > 1) return 0;
    reply->tag = taxel_byte(&r);
    if (kind == 0) {
        reply->kind = TAXEL_REPLY_VERSION;
        reply->as.version.protocol = (uint16_t)taxel_varint(&r);
        for (int i = 0; i < 3; i++) reply->as.version.firmware[i] = taxel_byte(&r);
        return r.ok;
    }
    if (taxel_choice(&r)) {
        reply->kind = TAXEL_REPLY_REFUSED;
        taxel_decode_refusal(&r, &reply->as.refusal);
        return r.ok;
    }
    uint64_t response = taxel_varint(&r);
    if (!r.ok || response > TAXEL_REPLY_SELF_TEST) return 0;
    reply->kind = (enum taxel_reply_kind)response;
    switch (reply->kind) {
    case TAXEL_REPLY_INFO: taxel_decode_info(&r, &reply->as.info); break;
    case TAXEL_REPLY_RATE: reply->as.rate_millihertz = (uint32_t)taxel_varint(&r); break;
    case TAXEL_REPLY_BIAS: taxel_decode_bias(&r, &reply->as.bias); break;
    case TAXEL_REPLY_SELF_TEST: taxel_decode_self_test(&r, &reply->as.self_test); break;
    default: break;
    }
    return r.ok;
}

/* Says in words how a request ended: "done", or why it was refused. */
static inline const char *taxel_reply_text(const struct taxel_reply *reply) {
    static const char *const refusals[] = {
        "out of range",
        "the finger is not still",
        "a bias or a self-test is running",
        "a chunk out of order",
        "the record is not a calibration",
        "there is no calibration",
        "a taxel is clipped",
        "the flash failed; what was stored before stays",
        "this board has no such thing",
        "the scan cannot be so",
    };
    if (reply->kind != TAXEL_REPLY_REFUSED) return "done";
    if (reply->as.refusal.number >= sizeof refusals / sizeof *refusals) return "refused for a reason of a later firmware";
    return refusals[reply->as.refusal.number];
}

#endif

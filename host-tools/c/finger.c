/* Talks to a finger on a serial port: who it is, a self-test, a tare, then its forces.
 *
 *     finger /dev/ttyACM0 [RATE [FRAMES]]
 *
 * POSIX only. Build: cmake -B build && cmake --build build
 */
#define _POSIX_C_SOURCE 200809L
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "taxel_command.h"

struct link {
    int port;
    uint8_t tag, received[512], packet[TAXEL_MAX_PACKET];
    size_t at, end, length;
};

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static int fail(const char *what) {
    fprintf(stderr, "finger: %s\n", what);
    return 0;
}

/* Opens the port for raw bytes. USB ignores the baud rate; a UART has 1 000 000 where the system knows it. */
static int open_port(struct link *link, const char *name) {
    struct termios settings;
    link->port = open(name, O_RDWR | O_NOCTTY);
    if (link->port < 0 || tcgetattr(link->port, &settings) != 0) return fail(strerror(errno));
    settings.c_iflag = settings.c_oflag = settings.c_lflag = 0;
    settings.c_cflag = CS8 | CREAD | CLOCAL;
    settings.c_cc[VMIN] = 1;
    settings.c_cc[VTIME] = 0;
#ifdef B1000000
    cfsetispeed(&settings, B1000000);
    cfsetospeed(&settings, B1000000);
#endif
    return tcsetattr(link->port, TCSANOW, &settings) == 0 ? 1 : fail(strerror(errno));
}

/* Receives the next whole message until the deadline. Returns its length, or 0. */
static size_t receive(struct link *link, double deadline, uint8_t message[TAXEL_MAX_PACKET]) {
    for (;;) {
        while (link->at < link->end) {
            uint8_t byte = link->received[link->at++];
            if (byte != 0) {
                if (link->length < sizeof link->packet) link->packet[link->length] = byte;
                link->length++;
                continue;
            }
            size_t size = taxel_unpack(link->packet, link->length, message);
            link->length = 0;
            if (size) return size;
        }
        double left = deadline - now();
        struct pollfd ready = {link->port, POLLIN, 0};
        if (left <= 0 || poll(&ready, 1, (int)(left * 1e3) + 1) < 0) return 0;
        if (!ready.revents) continue;
        ssize_t size = read(link->port, link->received, sizeof link->received);
        if (size <= 0) return 0;
        link->at = 0;
        link->end = (size_t)size;
    }
}

static int refused(const struct taxel_reply *reply) {
    const struct taxel_refusal *refusal = &reply->as.refusal;
    fprintf(stderr, "finger: %s", taxel_reply_text(reply));
    if (refusal->high > 0) fprintf(stderr, ": it must be %" PRIu32 " to %" PRIu32, refusal->low, refusal->high);
    fputc('\n', stderr);
    return 0;
}

/* Asks, up to four times half a second apart, or once with `patience` seconds. Says what went wrong. */
static int ask(struct link *link, enum taxel_command command, uint16_t argument, double patience,
               struct taxel_reply *reply) {
    uint8_t packet[TAXEL_MAX_PACKET], message[TAXEL_MAX_PACKET];
    size_t length = taxel_request(command, argument, ++link->tag, packet);
    for (int tries = patience > 0 ? 1 : 4; tries > 0; tries--) {
        /* The zero ends half a packet that the finger may still hold. */
        if (write(link->port, "", 1) != 1 || write(link->port, packet, length) != (ssize_t)length)
            return fail(strerror(errno));
        double deadline = now() + (patience > 0 ? patience : 0.5);
        for (size_t size; (size = receive(link, deadline, message)) > 0;) {
            if (!taxel_reply_decode(message, size, reply) || reply->tag != link->tag) continue;
            if ((reply->kind == TAXEL_REPLY_VERSION) != (command == TAXEL_VERSION)) continue;
            return reply->kind == TAXEL_REPLY_REFUSED ? refused(reply) : 1;
        }
    }
    return fail("nobody answers; is it a finger, and is its firmware running?");
}

static void noisiest(const struct taxel_channel *channels, int count, float *most) {
    for (int i = 0; i < count; i++)
        if (channels[i].present && channels[i].noise > *most) *most = channels[i].noise;
}

static void print_self_test(const struct taxel_self_test *test) {
    float most = 0;
    noisiest(test->lit, TAXEL_TAXELS, &most);
    for (int s = 0; s < TAXEL_SENSORS; s++) noisiest(test->bridges[s], 4, &most);
    printf("self-test: %u scans, noise at most %.1f of %" PRId32 " codes, record %s\n", test->scans, (double)most,
           test->full_scale, test->record_intact < 0 ? "absent" : test->record_intact ? "intact" : "damaged");
}

/* Returns how many frames are missing before this one, which came so many seconds after the last.
 * A gap of more frames than a finger sends in that time, at 10 kHz and held back by 10 s, is a restart. */
static uint32_t lost_before(uint32_t *next, uint32_t seq, double since) {
    uint32_t ahead = seq - *next;
    int possible = (double)ahead <= 10000.0 * (since + 10);
    /* Up to 256 frames back it is a duplicate. */
    if (possible || 0u - ahead > 256u) *next = seq + 1;
    return possible ? ahead : 0;
}

/* Streams frames; prints every hundredth. */
static int stream(struct link *link, long frames) {
    uint8_t message[TAXEL_MAX_PACKET];
    struct taxel_reply reply;
    struct taxel_frame frame;
    uint32_t next = 0, lost = 0;
    double last = now();
    if (!ask(link, TAXEL_STREAM, 1, 0, &reply)) return 0;
    for (long count = 0; count < frames;) {
        size_t size = receive(link, now() + 2, message);
        if (size == 0) return fail("the finger has gone silent");
        if (!taxel_frame_decode(message, size, &frame)) continue;
        if (count == 0) next = frame.seq;
        double since = now() - last;
        last += since;
        lost += lost_before(&next, frame.seq, since);
        if (count++ % 100 != 0) continue;
        if (taxel_given(frame.force[2])) printf("%.3f s  %.3f N\n", (double)frame.time_us * 1e-6, (double)frame.force[2].value);
        else printf("%.3f s  no value: %s\n", (double)frame.time_us * 1e-6, taxel_why_text(frame.force[2].why));
    }
    printf("%ld frames, %" PRIu32 " lost\n", frames, lost);
    return ask(link, TAXEL_STREAM, 0, 0, &reply);
}

static int run(struct link *link, uint16_t rate, long frames) {
    struct taxel_reply reply;
    if (!ask(link, TAXEL_VERSION, 0, 0, &reply)) return 0;
    const uint8_t *firmware = reply.as.version.firmware;
    printf("firmware %u.%u.%u, protocol %u\n", firmware[0], firmware[1], firmware[2], reply.as.version.protocol);
    if (reply.as.version.protocol != TAXEL_PROTOCOL) return fail("another protocol; install the header that goes with it");
    if (!ask(link, TAXEL_STREAM, 0, 0, &reply) || !ask(link, TAXEL_INFO, 0, 0, &reply)) return 0;
    printf("board %s, serial %s, %u scans a second\n", reply.as.info.board, reply.as.info.serial, reply.as.info.scan_hz);
    double scan_hz = reply.as.info.scan_hz ? reply.as.info.scan_hz : 1;
    if (!ask(link, TAXEL_SET_RATE, rate, 0, &reply)) return 0;
    printf("rate %.3f Hz\n", reply.as.rate_millihertz / 1000.0);
    if (!ask(link, TAXEL_SET_FIELDS, TAXEL_FIELD_FORCE | TAXEL_FIELD_POINT, 0, &reply)) return 0;
    if (!ask(link, TAXEL_SELF_TEST, 200, 2 + 200 / scan_hz, &reply)) return 0;
    print_self_test(&reply.as.self_test);
    if (!ask(link, TAXEL_TAKE_BIAS, 100, 2 + 100 / scan_hz, &reply)) return 0;
    printf("bias taken, noise %.6f of full scale\n", (double)reply.as.bias.taxel_noise);
    return stream(link, frames);
}

int main(int count, char **words) {
    struct link link = {.port = -1, .tag = (uint8_t)time(NULL)};
    if (count < 2 || count > 4) {
        fprintf(stderr, "usage: finger PORT [RATE [FRAMES]]\n");
        return 2;
    }
    long rate = count > 2 ? strtol(words[2], NULL, 10) : 1000;
    long frames = count > 3 ? strtol(words[3], NULL, 10) : 1000;
    if (rate < 0 || rate > 65535) rate = 0; /* refused by the finger, with the range */
    int well = open_port(&link, words[1]) && run(&link, (uint16_t)rate, frames);
    if (link.port >= 0) close(link.port);
    return well ? 0 : 1;
}

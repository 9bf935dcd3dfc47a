/* A plain control loop over the native stream, to compare punctuality with: one exchange a cycle, absolute deadlines.
 *
 *   stream_loop PATH RATE_HZ SECONDS      prints: cycles missed lost late_p50_us late_p99_us
 *
 * A cycle is missed when its deadline has passed by a whole period or more before it begins; lost when its answer does
 * not come within nine tenths of a period. Same words, same counting as `drivebench run`. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "drive_slave.h"

static double now_s(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + t.tv_nsec * 1e-9;
}

static void sleep_until(double until_s) {
    struct timespec t = {(time_t)until_s, (long)((until_s - (double)(time_t)until_s) * 1e9)};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR) {
    }
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* One command with zero output and its answer; 1 when the answer is that to this command. */
static int exchange(int fd, uint16_t number, double deadline_s) {
    uint8_t plain[DB_STREAM_MAX_FRAME] = {DB_MESSAGE_COMMAND, DB_PROTOCOL_VERSION}, frame[DB_STREAM_MAX_FRAME], bytes[512];
    drive_put16(plain + 2, number);
    drive_put16(plain + DB_STREAM_HEADER, DB_CONTROL_DISABLE);
    size_t length = drive_stream_encode(plain, DB_STREAM_HEADER + 6, frame), at = 0;
    if (write(fd, frame, length) != (ssize_t)length) return 0;
    for (;;) {
        double left_s = deadline_s - now_s();
        struct pollfd port = {fd, POLLIN, 0};
        struct timespec wait = {0, (long)(left_s * 1e9)};
        if (left_s <= 0 || ppoll(&port, 1, &wait, NULL) <= 0) return 0;
        ssize_t count = read(fd, bytes, sizeof bytes);
        if (count <= 0) return 0;
        for (ssize_t i = 0; i < count; i++) {
            if (bytes[i] != 0) {
                if (at < sizeof frame) frame[at++] = bytes[i];
                continue;
            }
            /* COBS; the checksum is not asked: nothing damages this line. */
            uint8_t out[DB_STREAM_MAX_FRAME];
            size_t from = 0, to = 0;
            while (from < at) {
                size_t code = frame[from];
                if (code == 0 || from + code > at) break;
                memcpy(out + to, frame + from + 1, code - 1);
                to += code - 1;
                from += code;
                if (code != 0xFF && from < at) out[to++] = 0;
            }
            at = 0;
            if (to >= DB_STREAM_HEADER && out[0] == DB_MESSAGE_TELEMETRY && drive_get16(out + 2) == number) return 1;
        }
    }
}

int main(int argc, char **argv) {
    if (argc != 4) {
        fprintf(stderr, "usage: stream_loop PATH RATE_HZ SECONDS\n");
        return 2;
    }
    int fd = open(argv[1], O_RDWR | O_NOCTTY);
    struct termios raw;
    if (fd < 0 || tcgetattr(fd, &raw) != 0) {
        fprintf(stderr, "stream_loop: %s: %s\n", argv[1], strerror(errno));
        return 1;
    }
    cfmakeraw(&raw);
    tcsetattr(fd, TCSANOW, &raw);
    tcflush(fd, TCIOFLUSH);
    double period_s = 1.0 / atof(argv[2]);
    long planned = (long)(atof(argv[3]) / period_s), cycles = 0, missed = 0, lost = 0;
    double *late = malloc((size_t)planned * sizeof *late), begin_s = now_s() + period_s;
    for (long cycle = 0; cycle < planned; cycle++) {
        double due_s = begin_s + (double)cycle * period_s;
        sleep_until(due_s);
        double at_s = now_s();
        long behind = (long)((at_s - due_s) / period_s);
        if (behind > 0) {
            missed += behind;
            cycle += behind;
            due_s = begin_s + (double)cycle * period_s;
        }
        late[cycles++] = at_s - due_s;
        lost += !exchange(fd, (uint16_t)(cycle + 1), at_s + 0.9 * period_s);
    }
    qsort(late, (size_t)cycles, sizeof *late, ascending);
    printf("%ld %ld %ld %.1f %.1f\n", cycles, missed, lost, late[cycles / 2] * 1e6, late[(long)((double)cycles * 0.99)] * 1e6);
    return 0;
}

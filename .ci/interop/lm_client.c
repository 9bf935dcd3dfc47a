/* A libmodbus client.
 *
 *   lm_client check rtu PATH | check tcp PORT      our software drive, register by register (SPEC.md)
 *   lm_client rate PATH COUNT GAP_US               reads of ten registers; prints: rate p50_us p99_us */
#define _GNU_SOURCE
#include <errno.h>
#include <modbus/modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static void expect(int is_right, const char *what) {
    if (!is_right) {
        fprintf(stderr, "lm_client: %s: %s\n", what, modbus_strerror(errno));
        exit(1);
    }
}

static double now_us(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1e6 + t.tv_nsec * 1e-3;
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static void check(modbus_t *ctx) {
    uint16_t words[125];
    expect(modbus_read_registers(ctx, 64, 17, words) == 17, "identity");
    expect(words[0] == 0x4442, "magic");
    expect((words[2] & 1) == 1, "the emulator says what it is");
    /* One command each time: its number comes back with the sample that was taken after it. */
    for (uint16_t number = 1; number <= 20; number++) {
        const uint16_t stop[4] = {number, 1, 0, 0};
        expect(modbus_write_and_read_registers(ctx, 32, 4, stop, 0, 16, words) == 16, "function code 23");
        expect(words[2] == number, "echo of the sequence number");
    }
    const uint16_t watchdog[1] = {750};
    expect(modbus_write_register(ctx, 73, 700) == 1, "function code 6");
    expect(modbus_read_registers(ctx, 73, 1, words) == 1 && words[0] == 700, "read back");
    expect(modbus_write_registers(ctx, 73, 1, watchdog) == 1, "function code 16");
    expect(modbus_read_registers(ctx, 73, 1, words) == 1 && words[0] == 750, "read back");
    expect(modbus_read_registers(ctx, 60000, 1, words) == -1 && errno == EMBXILADD, "exception 2");
    expect(modbus_write_register(ctx, 73, 1) == -1 && errno == EMBXILVAL, "exception 3");
    expect(modbus_read_registers(ctx, 64, 1, words) == 1 && words[0] == 0x4442, "all is well after exceptions");
}

static void rate(modbus_t *ctx, int count, int gap_us) {
    double *trips = malloc(count * sizeof *trips);
    uint16_t words[10];
    double begun = now_us(), last = begun;
    for (int i = 0; i < count; i++) {
        while (gap_us > 0 && now_us() < last + gap_us) {
            struct timespec rest = {0, 50000};
            if (now_us() < last + gap_us - 150) nanosleep(&rest, NULL);
        }
        double sent = now_us();
        expect(modbus_read_registers(ctx, 0, 10, words) == 10 && words[9] == 66, "read");
        last = now_us();
        trips[i] = last - sent;
    }
    double elapsed = now_us() - begun;
    qsort(trips, count, sizeof *trips, ascending);
    printf("%.0f %.1f %.1f\n", count / elapsed * 1e6, trips[count / 2], trips[(int)(count * 0.99)]);
}

int main(int argc, char **argv) {
    if (argc < 4) {
        fprintf(stderr, "usage: lm_client check rtu PATH | check tcp PORT | rate PATH COUNT GAP_US\n");
        return 2;
    }
    int is_rate = strcmp(argv[1], "rate") == 0;
    int is_tcp = !is_rate && strcmp(argv[2], "tcp") == 0;
    modbus_t *ctx = is_tcp ? modbus_new_tcp("127.0.0.1", atoi(argv[3]))
                           : modbus_new_rtu(argv[is_rate ? 2 : 3], 115200, 'N', 8, 1);
    expect(ctx != NULL && modbus_set_slave(ctx, 1) == 0, "context");
    /* A loaded machine only takes longer. */
    modbus_set_response_timeout(ctx, 5, 0);
    expect(modbus_connect(ctx) == 0, "connect");
    if (is_rate) {
        rate(ctx, atoi(argv[3]), atoi(argv[4]));
    } else {
        check(ctx);
    }
    modbus_close(ctx);
    modbus_free(ctx);
    return 0;
}

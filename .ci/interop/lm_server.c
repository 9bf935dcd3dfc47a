/* A libmodbus server for interop tests and rates: 200 holding registers of 7 i + 3, 200 input registers of i.
 *
 *   lm_server pty LINK     RTU, unit 1, on the master of a pseudo-terminal; LINK leads to its slave
 *   lm_server tcp PORT     on 127.0.0.1, one client after the other
 *
 * Prints one line when it can be reached. Ends with its standard input or by a signal. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <modbus/modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

enum { COUNT = 200 };

static void fail(const char *what) {
    fprintf(stderr, "lm_server: %s: %s\n", what, modbus_strerror(errno));
    exit(1);
}

static void answer(modbus_t *ctx, modbus_mapping_t *map) {
    uint8_t query[MODBUS_TCP_MAX_ADU_LENGTH];
    for (;;) {
        int length = modbus_receive(ctx, query);
        if (length > 0) {
            modbus_reply(ctx, query, length, map);
        } else if (length < 0 && (errno == ECONNRESET || errno == EPIPE || errno == EBADF || errno == EIO)) {
            return;
        }
    }
}

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "usage: lm_server pty LINK | lm_server tcp PORT\n");
        return 2;
    }
    modbus_mapping_t *map = modbus_mapping_new(0, 0, COUNT, COUNT);
    if (map == NULL) fail("mapping");
    for (int i = 0; i < COUNT; i++) {
        map->tab_registers[i] = (uint16_t)(7 * i + 3);
        map->tab_input_registers[i] = (uint16_t)i;
    }
    if (strcmp(argv[1], "tcp") == 0) {
        modbus_t *ctx = modbus_new_tcp("127.0.0.1", atoi(argv[2]));
        int listener = ctx == NULL ? -1 : modbus_tcp_listen(ctx, 1);
        if (listener < 0) fail(argv[2]);
        printf("ready\n");
        fflush(stdout);
        for (;;) {
            if (modbus_tcp_accept(ctx, &listener) < 0) fail("accept");
            answer(ctx, map);
        }
    }
    int master = posix_openpt(O_RDWR | O_NOCTTY);
    if (master < 0 || grantpt(master) < 0 || unlockpt(master) < 0) fail("pty");
    const char *slave = ptsname(master);
    /* Held open: else the master reports a hang-up for ever after its first client. */
    int held = open(slave, O_RDWR | O_NOCTTY);
    struct termios settings;
    if (held < 0 || tcgetattr(held, &settings) < 0) fail(slave);
    cfmakeraw(&settings);
    tcsetattr(held, TCSANOW, &settings);
    unlink(argv[2]);
    if (symlink(slave, argv[2]) < 0) fail(argv[2]);
    modbus_t *ctx = modbus_new_rtu(slave, 115200, 'N', 8, 1);
    if (ctx == NULL || modbus_set_slave(ctx, 1) < 0) fail("context");
    /* Not connected: it talks to the master that is open already. */
    modbus_set_socket(ctx, master);
    printf("ready\n");
    fflush(stdout);
    answer(ctx, map);
    return 0;
}

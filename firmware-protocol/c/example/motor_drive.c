/* The reference slave at work: a brushed motor behind an inverter, in real time, on a pseudo-terminal or a serial port.
 *
 *   motor_drive --link modbus-rtu|stream [--pty PATH | --tty DEVICE]
 *
 * --pty PATH: PATH becomes a symlink to a fresh pseudo-terminal for each host; without it there is one, for one host.
 * --tty DEVICE: a serial port, 115200 baud 8N1. When ready it prints one line as `drivebench emulate` does, e.g.
 *
 *   ready modbus-rtu /dev/pts/3 unit=1 baud=115200 profile=own
 *
 * and then:  drivebench run BENCH.toml --headless --port /dev/pts/3
 *
 * Everything of the operating system is in the lower half; the upper half is what a firmware author writes.
 */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE /* B115200 */

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "../drive_slave.h"

/* ---- Motor and inverter ---------------------------------------------------------------------------------------- */

#define TICK_US 50
#define TICK_S (TICK_US * 1e-6)
#define CAPTURE_TICKS 2
#define BURST 2048
#define UNIT 1

/* ZK-22FC, the motor of the default bench. */
#define RESISTANCE_OHM 1.1
#define INDUCTANCE_H 0.0099
#define BACK_EMF_V_S_PER_RAD 0.3538
#define INERTIA_KG_M2 0.0045
#define COULOMB_N_M 0.455

#define BUS_V 120.0
#define CURRENT_LIMIT_A 11.4
#define SPEED_LIMIT_RAD_S 350.0

/* Inner loops, tuned on the nameplate: current 200 Hz, speed 5 Hz. */
#define CURRENT_BANDWIDTH 1257.0
#define SPEED_BANDWIDTH 31.4

struct machine {
    struct drive_slave *slave;
    uint64_t tick;
    struct drive_demand demand;
    double current_a, speed_rad_s, angle_rad;
    double output_v;
    double capture_v; /* sum since the last captured sample */
    double current_integral_v, speed_integral_a;
    uint16_t limits;
};

static double clamp(double value, double limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

static uint32_t now_us(const struct machine *machine)
{
    return (uint32_t)(machine->tick * TICK_US);
}

/* What the demand asks of the output stage before its limits. */
static double wanted_v(struct machine *m)
{
    double target_a, error, volts;
    switch (m->demand.control) {
    case DB_CONTROL_VOLTAGE:
        return m->demand.set_point * 1e-3;
    case DB_CONTROL_CURRENT:
        target_a = m->demand.set_point * 1e-3;
        break;
    case DB_CONTROL_SPEED: {
        const double gain = SPEED_BANDWIDTH * INERTIA_KG_M2 / BACK_EMF_V_S_PER_RAD;
        error = clamp(m->demand.set_point * 1e-3, SPEED_LIMIT_RAD_S) - m->speed_rad_s;
        target_a = gain * error + m->speed_integral_a;
        if (fabs(target_a) < CURRENT_LIMIT_A || target_a * error < 0.0) {
            m->speed_integral_a += gain * SPEED_BANDWIDTH / 4.0 * TICK_S * error;
        }
        break;
    }
    default:
        return 0.0;
    }
    error = clamp(target_a, CURRENT_LIMIT_A) - m->current_a;
    volts = CURRENT_BANDWIDTH * INDUCTANCE_H * error + m->current_integral_v;
    if (fabs(volts) < BUS_V || volts * error < 0.0) {
        m->current_integral_v += CURRENT_BANDWIDTH * RESISTANCE_OHM * TICK_S * error;
    }
    return volts;
}

/* Supply first, then the chopping current limiter. */
static void limit_output(struct machine *m, double wanted)
{
    const double supplied = clamp(wanted, BUS_V);
    const double held_v = RESISTANCE_OHM * m->current_a + BACK_EMF_V_S_PER_RAD * m->speed_rad_s;
    const double per_ampere = INDUCTANCE_H / TICK_S;
    const double lowest = held_v + per_ampere * (-CURRENT_LIMIT_A - m->current_a);
    const double highest = held_v + per_ampere * (CURRENT_LIMIT_A - m->current_a);
    const double chopped = supplied < lowest ? lowest : supplied > highest ? highest : supplied;
    m->output_v = clamp(chopped, BUS_V);
    m->limits = (uint16_t)((fabs(supplied - wanted) > 0.0 ? DB_STATUS_VOLTAGE_LIMIT : 0) |
                           (fabs(chopped - supplied) > 0.0 ? DB_STATUS_CURRENT_LIMIT : 0));
}

static void turn(struct machine *m)
{
    const double torque = BACK_EMF_V_S_PER_RAD * m->current_a;
    double speed;
    m->current_a +=
        TICK_S / INDUCTANCE_H * (m->output_v - RESISTANCE_OHM * m->current_a - BACK_EMF_V_S_PER_RAD * m->speed_rad_s);
    if (m->speed_rad_s == 0.0) {
        const double excess = fabs(torque) - COULOMB_N_M;
        speed = excess > 0.0 ? copysign(TICK_S / INERTIA_KG_M2 * excess, torque) : 0.0;
    } else {
        speed = m->speed_rad_s + TICK_S / INERTIA_KG_M2 * (torque - copysign(COULOMB_N_M, m->speed_rad_s));
        if (speed * m->speed_rad_s < 0.0) {
            speed = 0.0; /* friction stops, it does not turn back */
        }
    }
    m->angle_rad += TICK_S * 0.5 * (speed + m->speed_rad_s);
    m->speed_rad_s = speed;
}

/* ---- The four functions that the slave asks for ---------------------------------------------------------------- */

static uint32_t apply(void *context, const struct drive_demand *demand)
{
    struct machine *const m = context;
    if (demand->control != m->demand.control) {
        /* A loop takes over from what the machine does now. */
        m->current_integral_v = m->output_v;
        m->speed_integral_a = m->current_a;
    }
    m->demand = *demand;
    limit_output(m, wanted_v(m));
    return now_us(m);
}

static void measure(void *context, struct drive_sample *sample)
{
    const struct machine *const m = context;
    sample->time_us = now_us(m);
    sample->voltage = drive_steps(m->output_v, DB_STREAM_VOLTAGE_PER_UNIT);
    sample->current = drive_steps(m->current_a, DB_STREAM_CURRENT_PER_UNIT);
    sample->speed = drive_steps(m->speed_rad_s, DB_STREAM_SPEED_PER_UNIT);
    sample->angle = drive_angle(m->angle_rad);
    sample->bus_voltage = drive_steps(BUS_V, DB_STREAM_BUS_VOLTAGE_PER_UNIT);
    sample->temperature = DB_STREAM_NOT_AVAILABLE; /* no sensor: missing, not 0 */
    sample->voltage_command = sample->voltage;
    sample->limits = m->limits;
}

static bool persists(void *context, uint16_t fault)
{
    const struct machine *const m = context;
    return fault == DB_FAULT_OVER_SPEED && fabs(m->speed_rad_s) > SPEED_LIMIT_RAD_S;
}

/* The control interrupt of a real drive. */
static void control_period(struct machine *m)
{
    drive_slave_tick(m->slave, now_us(m));
    if (fabs(m->speed_rad_s) > SPEED_LIMIT_RAD_S) {
        drive_slave_trip(m->slave, DB_FAULT_OVER_SPEED);
    }
    limit_output(m, wanted_v(m));
    turn(m);
    m->tick++;
    m->capture_v += m->output_v;
    if (m->tick % CAPTURE_TICKS == 0) {
        struct drive_sample sample;
        measure(m, &sample);
        sample.voltage = drive_steps(m->capture_v / CAPTURE_TICKS, DB_STREAM_VOLTAGE_PER_UNIT);
        m->capture_v = 0.0;
        drive_slave_record(m->slave, &sample);
    }
}

static const struct drive_config config = {
    .device_kind = DB_KIND_EMULATOR | DB_KIND_VOLTAGE | DB_KIND_CURRENT | DB_KIND_SPEED,
    .serial_number = 1,
    .firmware_version = 0x0100,
    .current_limit = (uint16_t)(CURRENT_LIMIT_A * DB_REG_CURRENT_LIMIT_PER_UNIT),
    .voltage_limit = (uint16_t)(BUS_V * DB_REG_VOLTAGE_LIMIT_PER_UNIT),
    .speed_limit = (uint16_t)(SPEED_LIMIT_RAD_S * DB_REG_SPEED_LIMIT_PER_UNIT),
    .watchdog_ms = 800,
    .pole_pairs = 0,
    .rated_voltage = 110 * DB_REG_RATED_VOLTAGE_PER_UNIT,
    .rated_current = 570,
    .rated_speed = 14660,
    .control_period_us = TICK_US,
    .capture_period_us = TICK_US * CAPTURE_TICKS,
    .names = {"drivebench", "c-drive", "1.0", NULL, "drivebench reference slave in C"},
};

/* ---- The operating system's part ------------------------------------------------------------------------------- */

/* Silence behind the buffers of an operating system is only certain after this time; on a UART it is 3.5 characters. */
#define SILENCE_US 20000

static volatile sig_atomic_t ended;

static void end(int signal)
{
    (void)signal;
    ended = 1;
}

static uint64_t clock_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000U + (uint64_t)now.tv_nsec / 1000U;
}

static void fail(const char *what)
{
    perror(what);
    exit(3);
}

/* No line discipline: bytes as they are. */
static void make_raw(int port, bool serial)
{
    struct termios mode;
    if (tcgetattr(port, &mode) != 0) {
        fail("terminal modes");
    }
    mode.c_iflag = 0;
    mode.c_oflag = 0;
    mode.c_lflag = 0;
    mode.c_cflag = CS8 | CREAD | CLOCAL;
    mode.c_cc[VMIN] = 0;
    mode.c_cc[VTIME] = 0;
    if (serial) {
        cfsetispeed(&mode, B115200);
        cfsetospeed(&mode, B115200);
    }
    if (tcsetattr(port, TCSANOW, &mode) != 0) {
        fail("terminal modes");
    }
}

/* A fresh pair; after a hang-up the old one is of no use. `path` is where the host finds it. */
static int open_pty(const char *stable, char *path, size_t room)
{
    const int port = posix_openpt(O_RDWR | O_NOCTTY);
    const char *name;
    if (port < 0 || grantpt(port) != 0 || unlockpt(port) != 0 || (name = ptsname(port)) == NULL) {
        fail("pseudo-terminal");
        return -1;
    }
    make_raw(port, false);
    if (fcntl(port, F_SETFL, O_NONBLOCK) != 0) {
        fail("pseudo-terminal");
    }
    if (stable != NULL) {
        char fresh[4096];
        snprintf(fresh, sizeof fresh, "%s.new", stable);
        unlink(fresh);
        if (symlink(name, fresh) != 0 || rename(fresh, stable) != 0) {
            fail(stable);
        }
        name = stable;
    }
    snprintf(path, room, "%s", name);
    return port;
}

static int open_tty(const char *device, char *path, size_t room)
{
    const int port = open(device, O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (port < 0) {
        fail(device);
    }
    make_raw(port, true);
    snprintf(path, room, "%s", device);
    return port;
}

/* False: the host has hung up. */
static bool send_all(int port, const uint8_t *bytes, size_t count)
{
    while (count > 0) {
        const ssize_t sent = write(port, bytes, count);
        if (sent > 0) {
            bytes += sent;
            count -= (size_t)sent;
        } else if (sent < 0 && errno == EAGAIN) {
            /* Nobody reads: the rest of this answer is lost, as on a line. */
            return true;
        } else if (sent < 0 && errno != EINTR) {
            return false;
        }
    }
    return true;
}

struct line {
    int port;
    bool stream;
    struct drive_modbus modbus;
    struct drive_stream decoder;
    uint64_t last_byte_us;
    bool waits_for_silence;
};

static bool send_modbus_answers(struct line *line)
{
    uint8_t answer[DB_RTU_MAX_FRAME];
    size_t length;
    while ((length = drive_modbus_answer(&line->modbus, answer)) > 0) {
        if (!send_all(line->port, answer, length)) {
            return false;
        }
    }
    return true;
}

/* What has come in; false: the host has hung up. */
static bool serve(struct line *line)
{
    uint8_t bytes[512], answer[DB_STREAM_MAX_FRAME];
    const ssize_t count = read(line->port, bytes, sizeof bytes);
    ssize_t at;
    if (count < 0) {
        return errno == EAGAIN || errno == EINTR;
    }
    for (at = 0; at < count; at++) {
        if (line->stream) {
            const size_t length = drive_stream_push(&line->decoder, bytes[at], answer);
            if (length > 0 && !send_all(line->port, answer, length)) {
                return false;
            }
        } else {
            drive_modbus_push(&line->modbus, bytes[at]);
            if (!send_modbus_answers(line)) {
                return false;
            }
        }
    }
    if (count > 0) {
        line->last_byte_us = clock_us();
        line->waits_for_silence = !line->stream;
    } else if (line->waits_for_silence && clock_us() - line->last_byte_us >= SILENCE_US) {
        line->waits_for_silence = false;
        drive_modbus_idle(&line->modbus);
        return send_modbus_answers(line);
    }
    return true;
}

static void usage(const char *program)
{
    fprintf(stderr, "usage: %s --link modbus-rtu|stream [--pty PATH | --tty DEVICE]\n", program);
    exit(2);
}

int main(int argc, char **argv)
{
    static struct drive_burst burst[BURST];
    static struct drive_slave slave;
    static struct machine machine;
    static struct line line;
    const struct drive_app app = {.context = &machine, .apply = apply, .measure = measure, .persists = persists};
    const char *kind = NULL, *pty = NULL, *tty = NULL;
    struct sigaction action;
    char path[4096];
    uint64_t start_us;
    int at;
    for (at = 1; at + 1 < argc; at += 2) {
        if (strcmp(argv[at], "--link") == 0) {
            kind = argv[at + 1];
        } else if (strcmp(argv[at], "--pty") == 0) {
            pty = argv[at + 1];
        } else if (strcmp(argv[at], "--tty") == 0) {
            tty = argv[at + 1];
        } else {
            usage(argv[0]);
        }
    }
    if (at != argc || kind == NULL || (strcmp(kind, "stream") != 0 && strcmp(kind, "modbus-rtu") != 0) ||
        (pty != NULL && tty != NULL)) {
        usage(argv[0]);
    }
    memset(&action, 0, sizeof action);
    action.sa_handler = end;
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);

    machine.slave = &slave;
    drive_slave_init(&slave, &config, &app, burst, BURST);
    drive_modbus_init(&line.modbus, &slave, UNIT);
    drive_stream_init(&line.decoder, &slave);
    line.stream = strcmp(kind, "stream") == 0;
    line.port = tty != NULL ? open_tty(tty, path, sizeof path) : open_pty(pty, path, sizeof path);
    printf("ready %s %s unit=%d baud=115200 profile=own\n", kind, path, UNIT);
    fflush(stdout);

    start_us = clock_us();
    while (!ended) {
        struct pollfd poll_port = {.fd = line.port, .events = POLLIN};
        bool there;
        /* The drive lives on at its own pace, whoever talks to it. */
        while (machine.tick * TICK_US + TICK_US <= clock_us() - start_us) {
            control_period(&machine);
        }
        there = serve(&line);
        if (there && poll(&poll_port, 1, 1) > 0 && (poll_port.revents & POLLHUP) != 0 &&
            (poll_port.revents & POLLIN) == 0) {
            there = false;
        }
        if (!there) {
            close(line.port);
            line.port = -1;
            if (pty == NULL) {
                break; /* the one host has gone */
            }
            drive_modbus_init(&line.modbus, &slave, UNIT);
            drive_stream_init(&line.decoder, &slave);
            line.port = open_pty(pty, path, sizeof path);
        }
    }
    if (pty != NULL) {
        unlink(pty);
    }
    return 0;
}

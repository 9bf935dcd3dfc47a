/* Plays a drive with known values, for the golden vectors and for tests that ask it anything.
 *
 *   replay rtu  ../../vectors/modbus-rtu.txt     every `>` line is pushed, the answer must be the `<` line
 *   replay tcp  ../../vectors/modbus-tcp.txt     the same requests behind another header
 *   replay stream ../../vectors/stream.txt       host's frames must be understood, the drive's be said to the byte
 *   replay talk rtu|stream                       lines of hexadecimal bytes on stdin, `idle` for a silence; answers on
 *                                                stdout, one a line, then `.`
 * Ends with 0 if all is as it should be.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../drive_slave.h"

#define LINE 8192
#define BURST 2000
#define UNIT 1

/* ---- The drive ------------------------------------------------------------------------------------------------- */

struct plant {
    struct drive_sample sample;
    uint32_t applied_us;
};

static uint32_t apply(void *context, const struct drive_demand *demand)
{
    const struct plant *const plant = context;
    (void)demand;
    return plant->applied_us;
}

static void measure(void *context, struct drive_sample *sample)
{
    const struct plant *const plant = context;
    *sample = plant->sample;
}

static bool persists(void *context, uint16_t fault)
{
    (void)context;
    (void)fault;
    return false;
}

/* The numbers of the vectors: tests/protocol/support.rs. */
static struct plant plant;
static struct drive_config config = {
    .device_kind = DB_KIND_EMULATOR | DB_KIND_VOLTAGE | DB_KIND_SPEED,
    .serial_number = 0x000186A1,
    .firmware_version = 0x0102,
    .current_limit = 12 * DB_REG_CURRENT_LIMIT_PER_UNIT,
    .voltage_limit = 48 * DB_REG_VOLTAGE_LIMIT_PER_UNIT,
    .speed_limit = 180 * DB_REG_SPEED_LIMIT_PER_UNIT,
    .watchdog_ms = 200,
    .pole_pairs = 0,
    .rated_voltage = 42 * DB_REG_RATED_VOLTAGE_PER_UNIT,
    .rated_current = 650,
    .rated_speed = 5236,
    .control_period_us = 100,
    .capture_period_us = 100,
    .names = {"drivebench", "DB-EMU", "1.2"},
};
static const struct drive_app app = {.context = &plant, .apply = apply, .measure = measure, .persists = persists};
static struct drive_burst burst[BURST];
static struct drive_slave slave;
static struct drive_modbus modbus;
static struct drive_stream stream;

static void command(uint16_t sequence, uint16_t control, int32_t set_point)
{
    const uint16_t block[DB_COMMAND_WORDS] = {sequence, control, (uint16_t)((uint32_t)set_point >> 16),
                                              (uint16_t)((uint32_t)set_point & 0xFFFF)};
    drive_slave_command(&slave, block);
}

static void power_up(void)
{
    plant.sample.time_us = 0x01020304;
    plant.applied_us = 0x01020000;
    plant.sample.voltage = drive_steps(24.0, DB_STREAM_VOLTAGE_PER_UNIT);
    plant.sample.current = drive_steps(-1.25, DB_STREAM_CURRENT_PER_UNIT);
    plant.sample.speed = drive_steps(60.5, DB_STREAM_SPEED_PER_UNIT);
    plant.sample.angle = drive_angle(-1234.5678);
    plant.sample.bus_voltage = drive_steps(48.2, DB_STREAM_BUS_VOLTAGE_PER_UNIT);
    plant.sample.temperature = drive_steps(31.4, DB_STREAM_TEMPERATURE_PER_UNIT);
    plant.sample.voltage_command = plant.sample.voltage;
    drive_slave_init(&slave, &config, &app, burst, BURST);
    drive_modbus_init(&modbus, &slave, UNIT);
    drive_stream_init(&stream, &slave);
    command(0x1234, DB_CONTROL_VOLTAGE, 24000);
}

/* ---- Text ------------------------------------------------------------------------------------------------------ */

static size_t parse(const char *text, uint8_t *bytes, size_t room)
{
    size_t count = 0;
    unsigned value;
    int used;
    while (count < room && sscanf(text, "%2x%n", &value, &used) == 1) {
        bytes[count++] = (uint8_t)value;
        text += used;
    }
    return count;
}

static void print(FILE *file, const char *what, const uint8_t *bytes, size_t count)
{
    size_t at;
    fputs(what, file);
    for (at = 0; at < count; at++) {
        fprintf(file, " %02x", bytes[at]);
    }
    fputc('\n', file);
}

static int same(const char *shows, const uint8_t *got, size_t got_count, const uint8_t *wanted, size_t wanted_count)
{
    if (got_count == wanted_count && memcmp(got, wanted, got_count) == 0) {
        return 0;
    }
    fprintf(stderr, "%s", shows);
    print(stderr, "  wanted", wanted, wanted_count);
    print(stderr, "  got   ", got, got_count);
    return 1;
}

/* ---- Modbus ---------------------------------------------------------------------------------------------------- */

/* Everything the drive says to a request and the silence after it. */
static size_t ask_rtu(const uint8_t *request, size_t count, uint8_t *said, size_t room)
{
    size_t at, end = 0, length;
    uint8_t answer[DB_RTU_MAX_FRAME];
    for (at = 0; at <= count; at++) {
        if (at < count) {
            drive_modbus_push(&modbus, request[at]);
        } else {
            drive_modbus_idle(&modbus);
        }
        while ((length = drive_modbus_answer(&modbus, answer)) > 0 && end + length <= room) {
            memcpy(said + end, answer, length);
            end += length;
        }
    }
    return end;
}

/* Transaction, protocol 0, length, unit; then the request as over RTU. */
static size_t ask_tcp(const uint8_t *request, size_t count, uint8_t *said, size_t room)
{
    size_t length;
    if (count < 8 || room < 7 + DB_MODBUS_MAX_PDU || drive_get16(request + 4) != count - 6) {
        return 0;
    }
    length = drive_modbus_respond(&slave, request + 7, count - 7, said + 7);
    memcpy(said, request, 7);
    drive_put16(said + 4, (uint16_t)(length + 1));
    return 7 + length;
}

static int replay_modbus(FILE *file, bool tcp)
{
    char line[LINE], shows[LINE] = "";
    uint8_t request[DB_RTU_MAX_FRAME + 8], wanted[DB_RTU_MAX_FRAME + 8], said[1024];
    size_t request_count = 0;
    int wrong = 0, exchanges = 0;
    while (fgets(line, sizeof line, file) != NULL) {
        if (line[0] == '#') {
            strcpy(shows, line);
        } else if (line[0] == '>') {
            request_count = parse(line + 1, request, sizeof request);
        } else if (line[0] == '<') {
            const size_t wanted_count = parse(line + 1, wanted, sizeof wanted);
            const size_t count = tcp ? ask_tcp(request, request_count, said, sizeof said)
                                     : ask_rtu(request, request_count, said, sizeof said);
            wrong += same(shows, said, count, wanted, wanted_count);
            exchanges++;
        }
    }
    printf("%d exchanges, %d wrong\n", exchanges, wrong);
    return wrong != 0 || exchanges == 0;
}

/* ---- Stream ---------------------------------------------------------------------------------------------------- */

static size_t ask_stream(const uint8_t *question, size_t count, uint8_t *said)
{
    size_t at, length = 0;
    for (at = 0; at < count; at++) {
        const size_t answered = drive_stream_push(&stream, question[at], said);
        length = answered > 0 ? answered : length;
    }
    return length;
}

static size_t question(uint8_t type, uint16_t sequence, const uint8_t *payload, size_t length, uint8_t *said)
{
    uint8_t plain[DB_STREAM_HEADER + 8] = {0}, frame[DB_STREAM_MAX_FRAME];
    plain[0] = type;
    plain[1] = DB_PROTOCOL_VERSION;
    drive_put16(plain + 2, sequence);
    if (length > 0) {
        memcpy(plain + DB_STREAM_HEADER, payload, length);
    }
    return ask_stream(frame, drive_stream_encode(plain, DB_STREAM_HEADER + length, frame), said);
}

static void record_everything(void)
{
    struct drive_sample sample;
    uint16_t at;
    memset(&sample, 0, sizeof sample);
    (void)drive_slave_control_capture(&slave, DB_CAPTURE_CONTROL_START);
    for (at = 0; at < BURST; at++) {
        const bool last = at == BURST - 1;
        sample.time_us = 500000 + 100 * (uint32_t)at;
        sample.voltage = last ? DB_STREAM_NOT_AVAILABLE : drive_steps(24.0, DB_STREAM_VOLTAGE_PER_UNIT);
        sample.current = last ? 0 : drive_steps(-2.5, DB_STREAM_CURRENT_PER_UNIT);
        sample.speed = drive_steps(last ? -0.5 : 60.0, DB_STREAM_SPEED_PER_UNIT);
        drive_slave_record(&slave, &sample);
    }
}

/* Brings the drive to where it says the frame of this type, and asks; `times`: how often the type came before. */
static size_t provoke(uint8_t type, uint16_t sequence, int times, uint8_t *said)
{
    static const uint8_t half_an_ampere[6] = {0, DB_CONTROL_CURRENT, 0, 0, 0x01, 0xF4};
    static const uint8_t index[2] = {1998 >> 8, 1998 & 0xFF};
    static struct drive_config real;
    power_up();
    plant.sample.time_us = 1000000;
    switch (type) {
    case DB_MESSAGE_IDENTITY:
        return question(DB_MESSAGE_HELLO, sequence, NULL, 0, said);
    case DB_MESSAGE_TELEMETRY:
        plant.sample.time_us = 0x01020304;
        if (times > 0) {
            /* Disabled, read before, and no emulator. */
            real = config;
            real.device_kind &= (uint16_t)~DB_KIND_EMULATOR;
            slave.config = &real;
            command(0x1234, DB_CONTROL_DISABLE, 0);
            (void)question(DB_MESSAGE_TELEMETRY_REQUEST, 0, NULL, 0, said);
        }
        return question(DB_MESSAGE_TELEMETRY_REQUEST, sequence, NULL, 0, said);
    case DB_MESSAGE_CAPTURE_STATUS:
        record_everything();
        return question(DB_MESSAGE_CAPTURE_STATUS_REQUEST, sequence, NULL, 0, said);
    case DB_MESSAGE_CAPTURE_BLOCK:
        record_everything();
        return question(DB_MESSAGE_CAPTURE_REQUEST, sequence, index, sizeof index, said);
    default:
        return question(DB_MESSAGE_COMMAND, sequence, half_an_ampere, sizeof half_an_ampere, said);
    }
}

/* Type and version are never 0 and sequence numbers of the vectors are below 256, so type and low byte of the number
 * stand at the same places of every frame. */
static int check_frame(const char *shows, const uint8_t *frame, size_t count, int times[256])
{
    uint8_t said[DB_STREAM_MAX_FRAME];
    const uint8_t type = frame[1];
    size_t length;
    if ((type & 0x80) != 0) {
        length = provoke(type, frame[4], times[type]++, said);
        return same(shows, said, length, frame, count);
    }
    power_up();
    length = ask_stream(frame, count, said);
    /* Only the current is nothing that this drive takes. */
    if (length == 0 || (said[1] == DB_MESSAGE_ERROR) != (strstr(shows, "current") != NULL)) {
        fprintf(stderr, "%s  not understood\n", shows);
        return 1;
    }
    return 0;
}

static int replay_stream(FILE *file)
{
    char line[LINE], shows[LINE] = "";
    uint8_t frame[DB_STREAM_MAX_FRAME];
    int times[256] = {0}, wrong = 0, frames = 0;
    while (fgets(line, sizeof line, file) != NULL) {
        if (line[0] == '#') {
            strcpy(shows, line);
        } else {
            const size_t count = parse(line, frame, sizeof frame);
            if (count > 5) {
                wrong += check_frame(shows, frame, count, times);
                frames++;
            }
        }
    }
    printf("%d frames, %d wrong\n", frames, wrong);
    return wrong != 0 || frames == 0;
}

/* ---- Talk ------------------------------------------------------------------------------------------------------ */

static int talk(bool rtu)
{
    static char line[1 << 18];
    static uint8_t bytes[sizeof line / 2];
    uint8_t answer[DB_STREAM_MAX_FRAME];
    while (fgets(line, sizeof line, stdin) != NULL) {
        const bool idle = strncmp(line, "idle", 4) == 0;
        const size_t count = idle ? 1 : parse(line, bytes, sizeof bytes);
        size_t at, length;
        for (at = 0; at < count; at++) {
            if (!rtu) {
                length = idle ? 0 : drive_stream_push(&stream, bytes[at], answer);
                if (length > 0) {
                    print(stdout, "<", answer, length);
                }
                continue;
            }
            if (idle) {
                drive_modbus_idle(&modbus);
            } else {
                drive_modbus_push(&modbus, bytes[at]);
            }
            while ((length = drive_modbus_answer(&modbus, answer)) > 0) {
                print(stdout, "<", answer, length);
            }
        }
        puts(".");
        fflush(stdout);
    }
    return 0;
}

int main(int argc, char **argv)
{
    FILE *file;
    int wrong;
    if (argc != 3) {
        fprintf(stderr, "usage: %s rtu|tcp|stream FILE, or %s talk rtu|stream\n", argv[0], argv[0]);
        return 2;
    }
    power_up();
    if (strcmp(argv[1], "talk") == 0) {
        return talk(strcmp(argv[2], "rtu") == 0);
    }
    file = fopen(argv[2], "r");
    if (file == NULL) {
        perror(argv[2]);
        return 2;
    }
    wrong = strcmp(argv[1], "stream") == 0 ? replay_stream(file) : replay_modbus(file, strcmp(argv[1], "tcp") == 0);
    fclose(file);
    return wrong;
}

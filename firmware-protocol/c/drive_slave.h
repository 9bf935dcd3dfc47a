/* A drive that speaks the drivebench protocol (../SPEC.md): Modbus RTU and the native stream.
 *
 *   bytes -> drive_modbus.c, drive_stream.c -> drive_map.c (registers, state machine, watchdog, capture) -> your control
 *
 * Portable C99: no allocation, no operating system, nothing of the C library but memcpy, memmove, memset and strlen.
 * Quantities are whole steps of the protocol, so no floating point is needed; drive_steps() is there for who has it.
 */
#ifndef DRIVE_SLAVE_H
#define DRIVE_SLAVE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "drive_protocol.h"

/* ---- What your control gives and takes ------------------------------------------------------------------------- */

/* One measured instant, in steps of DB_STREAM_*_PER_UNIT. A quantity that the drive does not have is
 * DB_STREAM_NOT_AVAILABLE, never 0; the angle is always there and wraps. */
struct drive_sample {
    uint32_t time_us;        /* drive time at which all of this was sampled; wraps */
    int32_t voltage;         /* armature, instantaneous, 10 uV */
    int32_t current;         /* armature, instantaneous, 10 uA */
    int32_t speed;           /* shaft, 20 urad/s */
    int32_t angle;           /* shaft, 0.1 mrad */
    int32_t bus_voltage;     /* 0.1 mV */
    int32_t temperature;     /* output stage, 0.1 mC */
    int32_t voltage_command; /* what the drive puts out now, after its limits, 10 uV */
    uint16_t limits;         /* DB_STATUS_CURRENT_LIMIT, DB_STATUS_VOLTAGE_LIMIT: active now */
};

/* What the output is to do. */
struct drive_demand {
    uint16_t control;  /* DB_CONTROL_DISABLE: off. _STOP: zero at once, within the current limit, then off.
                          _VOLTAGE, _CURRENT, _SPEED: the set-point, within your limits. */
    int32_t set_point; /* 1/1000 V, A or rad/s; 0 with DISABLE and STOP */
};

/* Your side. `lock` and `unlock` may be NULL where one context does everything; else they keep out whoever calls
 * drive_slave_tick, _trip and _record (save and restore the interrupt mask, or a mutex). */
struct drive_app {
    void *context;
    /* Puts the demand into force now or at the next period of the control, and gives the drive time at which it is in
     * force, microseconds. Called for every command and when the drive stops itself, under the lock: must not wait. */
    uint32_t (*apply)(void *context, const struct drive_demand *demand);
    /* One sample, not older than the last `apply`. Called without the lock; may wait for one control period. */
    void (*measure)(void *context, struct drive_sample *sample);
    /* Whether the cause of a fault of yours is still there: it then cannot be reset. Called under the lock. */
    bool (*persists)(void *context, uint16_t fault);
    void (*lock)(void *context);
    void (*unlock)(void *context);
};

#define DRIVE_NAMES 7

/* Who the drive is. Limits and ratings in steps of their registers, DB_REG_*_PER_UNIT. */
struct drive_config {
    uint16_t device_kind; /* DB_KIND_*: which set-points the drive takes */
    uint32_t serial_number;
    uint16_t firmware_version; /* high byte major, low byte minor */
    uint16_t current_limit, voltage_limit, speed_limit;
    uint16_t watchdog_ms; /* after power-up, DB_WATCHDOG_MIN_MS to DB_WATCHDOG_MAX_MS */
    uint16_t pole_pairs;  /* 0: brushed direct current */
    uint16_t rated_voltage, rated_current, rated_speed;
    uint16_t control_period_us;
    uint16_t capture_period_us; /* 0: no capture */
    /* Device identification: 0 vendor, 1 product code, 2 revision; NULL or 3 URL, 4 product name, 5 model,
     * 6 application. */
    const char *names[DRIVE_NAMES];
};

/* One captured instant, in the steps of drive_sample. */
struct drive_burst {
    int32_t voltage, current, speed;
};

/* ---- The drive ------------------------------------------------------------------------------------------------- */

/* Registers, state machine, watchdog and capture. Fields are the library's own. */
struct drive_slave {
    const struct drive_config *config;
    const struct drive_app *app;
    struct drive_burst *burst;
    uint16_t burst_length;

    uint16_t state, fault;
    uint16_t command[DB_COMMAND_WORDS]; /* as the host reads it back */
    uint16_t sequence;                  /* of the last command applied */
    uint32_t applied_us, kicked_us;
    bool applied_unread;
    uint16_t watchdog_ms;

    uint16_t capture_control, capture_state, capture_count, window_index;
    uint32_t capture_us;
};

/* Power-up: disabled. `config` and `app` must outlive the slave; `burst` is room for `burst_length` captured samples,
 * NULL and 0 if capture_period_us is 0. */
void drive_slave_init(struct drive_slave *slave, const struct drive_config *config, const struct drive_app *app,
                      struct drive_burst *burst, uint16_t burst_length);

/* The watchdog. Call it from the control itself, every period or at least every millisecond: a hung main loop must not
 * keep it from acting. */
void drive_slave_tick(struct drive_slave *slave, uint32_t now_us);

/* Stops the drive with a fault of your own (DB_FAULT_*); the first one stays. */
void drive_slave_trip(struct drive_slave *slave, uint16_t fault);

/* Offers a sample to the capture; call it every capture_period_us. Its voltage is the mean over the period that ends
 * with it, as SPEC.md 2.4 says; the rest is instantaneous. */
void drive_slave_record(struct drive_slave *slave, const struct drive_sample *sample);

/* ---- Modbus RTU ------------------------------------------------------------------------------------------------ */

struct drive_modbus {
    struct drive_slave *slave;
    uint8_t unit;
    bool gap;
    size_t length;
    uint8_t buffer[DB_RTU_MAX_FRAME];
};

/* unit: 1 to 247. */
void drive_modbus_init(struct drive_modbus *modbus, struct drive_slave *slave, uint8_t unit);

/* Takes one byte of the line. Ask drive_modbus_answer afterwards. */
void drive_modbus_push(struct drive_modbus *modbus, uint8_t byte);

/* The line was silent for 3.5 characters (above 19200 baud: 1.75 ms) or more. Ask drive_modbus_answer afterwards. */
void drive_modbus_idle(struct drive_modbus *modbus);

/* Executes what has come and writes the next answer; gives its bytes. 0: none; ask until it is 0. */
size_t drive_modbus_answer(struct drive_modbus *modbus, uint8_t answer[DB_RTU_MAX_FRAME]);

/* Executes one request without framing, as Modbus TCP carries it behind its header; gives the bytes of the response,
 * 0 only for an empty request. */
size_t drive_modbus_respond(struct drive_slave *slave, const uint8_t *request, size_t length,
                            uint8_t response[DB_MODBUS_MAX_PDU]);

/* ---- Native stream --------------------------------------------------------------------------------------------- */

struct drive_stream {
    struct drive_slave *slave;
    size_t length;
    bool overflow;
    uint8_t buffer[DB_STREAM_MAX_FRAME];
};

void drive_stream_init(struct drive_stream *stream, struct drive_slave *slave);

/* Takes one byte of the line; gives the bytes of the answer that it causes, 0: none. */
size_t drive_stream_push(struct drive_stream *stream, uint8_t byte, uint8_t answer[DB_STREAM_MAX_FRAME]);

/* Frames header and payload of `length` bytes in `plain`, behind which there is room for the checksum; gives the bytes
 * of the frame, delimiter included. */
size_t drive_stream_encode(uint8_t *plain, size_t length, uint8_t frame[DB_STREAM_MAX_FRAME]);

/* ---- Between the protocols and the map ------------------------------------------------------------------------- */

uint16_t drive_get16(const uint8_t *bytes);
uint32_t drive_get32(const uint8_t *bytes);
void drive_put16(uint8_t *bytes, uint16_t value);
void drive_put32(uint8_t *bytes, uint32_t value);
int32_t drive_signed32(uint32_t raw);

/* Whether every address of the range holds a register. */
bool drive_map_readable(uint16_t address, size_t count);
/* Registers of a readable range, big-endian. */
void drive_map_read(struct drive_slave *slave, uint16_t address, size_t count, uint8_t *bytes);
/* Writes big-endian values, all or none; 0 or the exception. */
uint8_t drive_map_write(struct drive_slave *slave, uint16_t address, size_t count, const uint8_t *bytes);

/* A sample with what the state machine adds to it. Clears the mark that a command was applied. */
struct drive_telemetry {
    struct drive_sample sample;
    uint16_t status, fault, sequence;
    uint32_t applied_us;
};
void drive_slave_telemetry(struct drive_slave *slave, bool reads_status, struct drive_telemetry *telemetry);
void drive_slave_identity(const struct drive_slave *slave, uint16_t words[DB_IDENTITY_WORDS]);
bool drive_slave_supports(const struct drive_slave *slave, uint16_t control);
/* A valid command block: applied, echoed, kicks the watchdog. */
void drive_slave_command(struct drive_slave *slave, const uint16_t block[DB_COMMAND_WORDS]);
bool drive_slave_set_watchdog(struct drive_slave *slave, uint16_t ms);
bool drive_slave_control_capture(struct drive_slave *slave, uint16_t control);
/* At most `most` captured samples from `index` on; gives how many. */
size_t drive_slave_captured(const struct drive_slave *slave, uint16_t index, size_t most,
                            const struct drive_burst **first);

/* ---- For who measures in floating point ------------------------------------------------------------------------ */

/* Nearest whole step, halves to the even one, of what is within 32 bits. */
static inline int64_t drive_nearest(double steps)
{
    const int64_t whole = (int64_t)steps;
    const double rest = steps < 0.0 ? (double)whole - steps : steps - (double)whole;
    const bool is_odd = whole % 2 != 0;
    return rest > 0.5 || (is_odd && rest >= 0.5) ? whole + (steps < 0.0 ? -1 : 1) : whole;
}

/* The same of a value; saturates; NaN is "not available". */
static inline int32_t drive_steps(double value, double steps_per_unit)
{
    const double steps = value * steps_per_unit;
    if (steps != steps) {
        return DB_STREAM_NOT_AVAILABLE;
    }
    if (steps >= 2147483647.0) {
        return 2147483647;
    }
    if (steps <= -2147483647.0) {
        return -2147483647;
    }
    return (int32_t)drive_nearest(steps);
}

/* The angle of drive_sample: wraps instead of saturating. */
static inline int32_t drive_angle(double angle_rad)
{
    const double steps = angle_rad * (double)DB_STREAM_ANGLE_PER_UNIT;
    return drive_signed32((uint32_t)drive_nearest(steps));
}

#endif

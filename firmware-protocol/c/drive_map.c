/* Registers, state machine, watchdog and capture. The table of the registers is the generated one: DB_REGISTERS. */
#include "drive_slave.h"

#include <string.h>

struct reg {
    uint16_t address;
    uint8_t words, is_signed, is_writable;
    uint16_t repeat, stride;
    int64_t lowest, highest;
};

#define DRIVE_ROW(name, address, words, is_signed, is_writable, lowest, highest, repeat, stride)                      \
    {address, words, is_signed, is_writable, repeat, stride, lowest, highest},
static const struct reg table[] = {DB_REGISTERS(DRIVE_ROW)};

/* Places in the command block. */
enum { SEQUENCE, CONTROL, SET_POINT_HIGH, SET_POINT_LOW };

#define SET_POINT_WORDS 2
#define STREAM_FINER 1000

static void lock(const struct drive_slave *slave)
{
    if (slave->app->lock != NULL) {
        slave->app->lock(slave->app->context);
    }
}

static void unlock(const struct drive_slave *slave)
{
    if (slave->app->unlock != NULL) {
        slave->app->unlock(slave->app->context);
    }
}

uint16_t drive_get16(const uint8_t *bytes)
{
    return (uint16_t)((uint16_t)((uint16_t)bytes[0] << 8) | bytes[1]);
}

uint32_t drive_get32(const uint8_t *bytes)
{
    return (uint32_t)drive_get16(bytes) << 16 | drive_get16(bytes + 2);
}

void drive_put16(uint8_t *bytes, uint16_t value)
{
    bytes[0] = (uint8_t)(value >> 8);
    bytes[1] = (uint8_t)(value & 0xFF);
}

void drive_put32(uint8_t *bytes, uint32_t value)
{
    drive_put16(bytes, (uint16_t)(value >> 16));
    drive_put16(bytes + 2, (uint16_t)(value & 0xFFFF));
}

/* C leaves the plain cast of a large number to the compiler. */
int32_t drive_signed32(uint32_t raw)
{
    return raw <= 0x7FFFFFFFU ? (int32_t)raw : -(int32_t)(UINT32_MAX - raw) - 1;
}

/* ---- State machine --------------------------------------------------------------------------------------------- */

void drive_slave_init(struct drive_slave *slave, const struct drive_config *config, const struct drive_app *app,
                      struct drive_burst *burst, uint16_t burst_length)
{
    memset(slave, 0, sizeof *slave);
    slave->config = config;
    slave->app = app;
    slave->burst = burst;
    slave->burst_length = burst_length;
    slave->watchdog_ms = config->watchdog_ms;
    slave->state = DB_STATE_DISABLED;
}

static bool energises(uint16_t control)
{
    return control == DB_CONTROL_VOLTAGE || control == DB_CONTROL_CURRENT || control == DB_CONTROL_SPEED;
}

bool drive_slave_supports(const struct drive_slave *slave, uint16_t control)
{
    return !energises(control) || (slave->config->device_kind >> (8 + control) & 1) != 0;
}

static void forget_set_point(uint16_t block[DB_COMMAND_WORDS])
{
    block[SET_POINT_HIGH] = 0;
    block[SET_POINT_LOW] = 0;
}

/* Under the lock. */
static void trip(struct drive_slave *slave, uint16_t fault)
{
    const struct drive_demand stop = {DB_CONTROL_STOP, 0};
    if (slave->state == DB_STATE_FAULT) {
        return;
    }
    slave->state = DB_STATE_FAULT;
    slave->fault = fault;
    /* What was asked before must not come back with a later write of a part of the block. */
    slave->command[CONTROL] = DB_CONTROL_DISABLE;
    forget_set_point(slave->command);
    (void)slave->app->apply(slave->app->context, &stop);
}

void drive_slave_trip(struct drive_slave *slave, uint16_t fault)
{
    lock(slave);
    trip(slave, fault);
    unlock(slave);
}

void drive_slave_tick(struct drive_slave *slave, uint32_t now_us)
{
    lock(slave);
    if (slave->state == DB_STATE_RUNNING) {
        /* Signed: a command may come into force a moment from now. */
        const int32_t silence_us = drive_signed32(now_us - slave->kicked_us);
        if (silence_us >= (int32_t)slave->watchdog_ms * 1000) {
            trip(slave, DB_FAULT_WATCHDOG);
        }
    }
    unlock(slave);
}

static void begin_capture(struct drive_slave *slave, uint16_t state)
{
    slave->capture_state = state;
    slave->capture_count = 0;
}

void drive_slave_command(struct drive_slave *slave, const uint16_t block[DB_COMMAND_WORDS])
{
    const uint16_t control = block[CONTROL];
    struct drive_demand demand = {DB_CONTROL_STOP, 0};
    lock(slave);
    if (slave->state == DB_STATE_FAULT) {
        if (control == DB_CONTROL_RESET_FAULT && !slave->app->persists(slave->app->context, slave->fault)) {
            slave->state = DB_STATE_DISABLED;
            slave->fault = DB_FAULT_NONE;
            demand.control = DB_CONTROL_DISABLE;
        }
    } else if (energises(control)) {
        slave->state = DB_STATE_RUNNING;
        demand.control = control;
        demand.set_point =
            drive_signed32((uint32_t)block[SET_POINT_HIGH] << 16 | block[SET_POINT_LOW]);
    } else if (control == DB_CONTROL_STOP) {
        slave->state = DB_STATE_READY;
    } else {
        slave->state = DB_STATE_DISABLED;
        demand.control = DB_CONTROL_DISABLE;
    }
    memcpy(slave->command, block, sizeof slave->command);
    if (!energises(control)) {
        forget_set_point(slave->command);
    }
    slave->applied_us = slave->app->apply(slave->app->context, &demand);
    slave->kicked_us = slave->applied_us;
    slave->sequence = block[SEQUENCE];
    slave->applied_unread = true;
    if (slave->capture_state == DB_CAPTURE_ARMED) {
        begin_capture(slave, DB_CAPTURE_RECORDING);
    }
    unlock(slave);
}

bool drive_slave_set_watchdog(struct drive_slave *slave, uint16_t ms)
{
    if (ms < DB_WATCHDOG_MIN_MS || ms > DB_WATCHDOG_MAX_MS) {
        return false;
    }
    lock(slave);
    slave->watchdog_ms = ms;
    unlock(slave);
    return true;
}

/* ---- Capture --------------------------------------------------------------------------------------------------- */

bool drive_slave_control_capture(struct drive_slave *slave, uint16_t control)
{
    const bool has_none = slave->config->capture_period_us == 0 || slave->burst_length == 0;
    if (control != DB_CAPTURE_CONTROL_ABORT && has_none) {
        return false;
    }
    lock(slave);
    slave->capture_control = control;
    begin_capture(slave, control == DB_CAPTURE_CONTROL_ARM     ? DB_CAPTURE_ARMED
                         : control == DB_CAPTURE_CONTROL_START ? DB_CAPTURE_RECORDING
                                                               : DB_CAPTURE_EMPTY);
    unlock(slave);
    return true;
}

void drive_slave_record(struct drive_slave *slave, const struct drive_sample *sample)
{
    lock(slave);
    if (slave->capture_state == DB_CAPTURE_RECORDING) {
        struct drive_burst *const slot = &slave->burst[slave->capture_count];
        if (slave->capture_count == 0) {
            slave->capture_us = sample->time_us;
        }
        slot->voltage = sample->voltage;
        slot->current = sample->current;
        slot->speed = sample->speed;
        slave->capture_count++;
        if (slave->capture_count == slave->burst_length) {
            slave->capture_state = DB_CAPTURE_COMPLETE;
        }
    }
    unlock(slave);
}

size_t drive_slave_captured(const struct drive_slave *slave, uint16_t index, size_t most,
                            const struct drive_burst **first)
{
    size_t count;
    if (index >= slave->capture_count) {
        return 0;
    }
    count = (size_t)slave->capture_count - index;
    *first = &slave->burst[index];
    return count < most ? count : most;
}

/* ---- Blocks ---------------------------------------------------------------------------------------------------- */

void drive_slave_telemetry(struct drive_slave *slave, bool reads_status, struct drive_telemetry *telemetry)
{
    memset(telemetry, 0, sizeof *telemetry);
    slave->app->measure(slave->app->context, &telemetry->sample);
    lock(slave);
    telemetry->status = (uint16_t)(slave->state | telemetry->sample.limits);
    if (slave->fault == DB_FAULT_WATCHDOG) {
        telemetry->status |= DB_STATUS_WATCHDOG;
    }
    if (slave->applied_unread) {
        telemetry->status |= DB_STATUS_COMMAND_APPLIED;
    }
    if ((slave->config->device_kind & DB_KIND_EMULATOR) != 0) {
        telemetry->status |= DB_STATUS_EMULATOR;
    }
    telemetry->fault = slave->fault;
    telemetry->sequence = slave->sequence;
    telemetry->applied_us = slave->applied_us;
    if (reads_status) {
        slave->applied_unread = false;
    }
    unlock(slave);
}

/* A value of the stream in the coarser steps of a register: rounded, halves to the even one, saturated. */
static uint16_t coarse(int32_t fine, int32_t lowest, int32_t highest, int32_t not_available)
{
    const int32_t half = STREAM_FINER / 2;
    int32_t raw, most;
    if (fine == DB_STREAM_NOT_AVAILABLE) {
        return (uint16_t)not_available;
    }
    raw = fine / STREAM_FINER;
    most = raw % 2 != 0 ? half - 1 : half;
    if (fine % STREAM_FINER > most) {
        raw++;
    } else if (fine % STREAM_FINER < -most) {
        raw--;
    }
    return (uint16_t)(raw < lowest ? lowest : raw > highest ? highest : raw);
}

static uint16_t coarse_signed(int32_t fine)
{
    return coarse(fine, -32767, 32767, -32767 - 1);
}

static void put_pair(uint16_t *words, uint32_t value)
{
    words[0] = (uint16_t)(value >> 16);
    words[1] = (uint16_t)(value & 0xFFFF);
}

static void telemetry_words(const struct drive_telemetry *telemetry, uint16_t words[DB_TELEMETRY_WORDS])
{
    const struct drive_sample *const sample = &telemetry->sample;
    words[DB_REG_STATUS] = telemetry->status;
    words[DB_REG_FAULT] = telemetry->fault;
    words[DB_REG_SEQUENCE_ECHO] = telemetry->sequence;
    put_pair(&words[DB_REG_TIME], sample->time_us);
    put_pair(&words[DB_REG_APPLIED_TIME], telemetry->applied_us);
    words[DB_REG_VOLTAGE] = coarse_signed(sample->voltage);
    words[DB_REG_CURRENT] = coarse_signed(sample->current);
    words[DB_REG_SPEED] = coarse_signed(sample->speed);
    put_pair(&words[DB_REG_ANGLE], (uint32_t)sample->angle);
    words[DB_REG_BUS_VOLTAGE] = coarse(sample->bus_voltage, 0, 65534, 65535);
    words[DB_REG_TEMPERATURE] = coarse_signed(sample->temperature);
    words[DB_REG_VOLTAGE_COMMAND] = coarse_signed(sample->voltage_command);
    words[DB_REG_TELEMETRY_VERSION] = DB_PROTOCOL_VERSION;
}

#define IN_IDENTITY(name) (DB_REG_##name - DB_REG_MAGIC)

void drive_slave_identity(const struct drive_slave *slave, uint16_t words[DB_IDENTITY_WORDS])
{
    const struct drive_config *const config = slave->config;
    words[IN_IDENTITY(MAGIC)] = DB_MAGIC;
    words[IN_IDENTITY(PROTOCOL_VERSION)] = DB_PROTOCOL_VERSION;
    words[IN_IDENTITY(DEVICE_KIND)] = config->device_kind;
    put_pair(&words[IN_IDENTITY(SERIAL_NUMBER)], config->serial_number);
    words[IN_IDENTITY(FIRMWARE_VERSION)] = config->firmware_version;
    words[IN_IDENTITY(CURRENT_LIMIT)] = config->current_limit;
    words[IN_IDENTITY(VOLTAGE_LIMIT)] = config->voltage_limit;
    words[IN_IDENTITY(SPEED_LIMIT)] = config->speed_limit;
    words[IN_IDENTITY(WATCHDOG)] = slave->watchdog_ms;
    words[IN_IDENTITY(POLE_PAIRS)] = config->pole_pairs;
    words[IN_IDENTITY(RATED_VOLTAGE)] = config->rated_voltage;
    words[IN_IDENTITY(RATED_CURRENT)] = config->rated_current;
    words[IN_IDENTITY(RATED_SPEED)] = config->rated_speed;
    words[IN_IDENTITY(CONTROL_PERIOD)] = config->control_period_us;
    words[IN_IDENTITY(CAPTURE_PERIOD)] = config->capture_period_us;
    words[IN_IDENTITY(CAPTURE_LENGTH)] = slave->burst_length;
}

/* A register of the capture block. */
static uint16_t capture_word(const struct drive_slave *slave, uint16_t address)
{
    const struct drive_burst *first = NULL;
    const size_t count = drive_slave_captured(slave, slave->window_index, DB_CAPTURE_WINDOW_SAMPLES, &first);
    size_t sample;
    switch (address) {
    case DB_REG_CAPTURE_CONTROL:
        return slave->capture_control;
    case DB_REG_CAPTURE_STATE:
        return slave->capture_state;
    case DB_REG_CAPTURE_COUNT:
        return slave->capture_count;
    case DB_REG_CAPTURE_TIME:
        return (uint16_t)(slave->capture_us >> 16);
    case DB_REG_CAPTURE_TIME + 1:
        return (uint16_t)(slave->capture_us & 0xFFFF);
    case DB_REG_WINDOW_INDEX:
        return slave->window_index;
    case DB_REG_WINDOW_COUNT:
        return (uint16_t)count;
    default:
        break;
    }
    sample = (size_t)(address - DB_REG_WINDOW_VOLTAGE) / 3;
    if (sample >= count) {
        return coarse_signed(DB_STREAM_NOT_AVAILABLE);
    }
    switch ((address - DB_REG_WINDOW_VOLTAGE) % 3) {
    case 0:
        return coarse_signed(first[sample].voltage);
    case 1:
        return coarse_signed(first[sample].current);
    default:
        return coarse_signed(first[sample].speed);
    }
}

/* ---- Map ------------------------------------------------------------------------------------------------------- */

/* What stands at an address, and which word of its value; NULL: no register. */
static const struct reg *find(uint32_t address, uint16_t *word)
{
    size_t row;
    for (row = 0; row < sizeof table / sizeof table[0]; row++) {
        const struct reg *const reg = &table[row];
        uint32_t offset = address - reg->address;
        if (address < reg->address) {
            break; /* the rows rise */
        }
        if (reg->stride != 0) {
            if (offset / reg->stride >= reg->repeat) {
                continue;
            }
            offset %= reg->stride;
        }
        if (offset < reg->words) {
            *word = (uint16_t)offset;
            return reg;
        }
    }
    return NULL;
}

bool drive_map_readable(uint16_t address, size_t count)
{
    size_t offset;
    uint16_t word;
    for (offset = 0; offset < count; offset++) {
        if (find((uint32_t)address + (uint32_t)offset, &word) == NULL) {
            return false;
        }
    }
    return true;
}

void drive_map_read(struct drive_slave *slave, uint16_t address, size_t count, uint8_t *bytes)
{
    uint16_t telemetry_block[DB_TELEMETRY_WORDS] = {0};
    uint16_t identity_block[DB_IDENTITY_WORDS];
    size_t offset;
    if (address < DB_TELEMETRY_WORDS) {
        struct drive_telemetry telemetry;
        drive_slave_telemetry(slave, address == DB_REG_STATUS, &telemetry);
        telemetry_words(&telemetry, telemetry_block);
    }
    drive_slave_identity(slave, identity_block);
    lock(slave);
    for (offset = 0; offset < count; offset++) {
        const uint16_t at = (uint16_t)(address + offset);
        const uint16_t word = at < DB_REG_SEQUENCE        ? telemetry_block[at]
                              : at < DB_REG_MAGIC         ? slave->command[at - DB_REG_SEQUENCE]
                              : at < DB_REG_CAPTURE_CONTROL ? identity_block[at - DB_REG_MAGIC]
                                                          : capture_word(slave, at);
        drive_put16(bytes + 2 * offset, word);
    }
    unlock(slave);
}

/* Existence, access, whole values, raw range, in the order of the addresses. */
static uint8_t judge_write(uint16_t address, size_t count, const uint8_t *bytes)
{
    size_t offset = 0;
    while (offset < count) {
        uint16_t word;
        const struct reg *const reg = find((uint32_t)address + (uint32_t)offset, &word);
        const uint8_t *const at = bytes + 2 * offset;
        int64_t raw;
        if (reg == NULL || reg->is_writable == 0 || word != 0 || count - offset < reg->words) {
            return DB_EXCEPTION_ILLEGAL_ADDRESS;
        }
        if (reg->words == 1) {
            raw = drive_get16(at); /* every writable one is unsigned */
        } else if (reg->is_signed) {
            raw = drive_signed32(drive_get32(at));
        } else {
            raw = drive_get32(at);
        }
        if (raw < reg->lowest || raw > reg->highest) {
            return DB_EXCEPTION_ILLEGAL_VALUE;
        }
        offset += reg->words;
    }
    return 0;
}

/* A write to a part of the command block; the rest counts as last written. */
static uint8_t write_command(struct drive_slave *slave, size_t at, size_t count, const uint8_t *bytes)
{
    uint16_t next[DB_COMMAND_WORDS];
    size_t offset;
    bool control_changed;
    lock(slave);
    memcpy(next, slave->command, sizeof next);
    unlock(slave);
    control_changed = false;
    for (offset = 0; offset < count; offset++) {
        const uint16_t word = drive_get16(bytes + 2 * offset);
        if (at + offset == CONTROL) {
            control_changed = word != next[CONTROL];
        }
        next[at + offset] = word;
    }
    /* A voltage must not become a speed because the control word alone was changed. */
    if (control_changed && at + count < DB_COMMAND_WORDS) {
        forget_set_point(next);
    }
    if (!drive_slave_supports(slave, next[CONTROL])) {
        return DB_EXCEPTION_ILLEGAL_VALUE;
    }
    drive_slave_command(slave, next);
    return 0;
}

uint8_t drive_map_write(struct drive_slave *slave, uint16_t address, size_t count, const uint8_t *bytes)
{
    const uint8_t exception = judge_write(address, count, bytes);
    const uint16_t value = drive_get16(bytes);
    if (exception != 0) {
        return exception;
    }
    /* The writable registers beside the command block have no writable neighbours. */
    switch (address) {
    case DB_REG_WATCHDOG:
        return drive_slave_set_watchdog(slave, value) ? 0 : DB_EXCEPTION_ILLEGAL_VALUE;
    case DB_REG_CAPTURE_CONTROL:
        return drive_slave_control_capture(slave, value) ? 0 : DB_EXCEPTION_ILLEGAL_VALUE;
    case DB_REG_WINDOW_INDEX:
        slave->window_index = value;
        return 0;
    default:
        return write_command(slave, (size_t)(address - DB_REG_SEQUENCE), count, bytes);
    }
}

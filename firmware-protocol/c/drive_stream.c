/* The native stream: COBS frames with a sequence number, drive time and a checksum; every question gets one answer. */
#include "drive_slave.h"

#include <string.h>

#define CRC_BYTES 2

static uint16_t crc16(const uint8_t *bytes, size_t length)
{
    static const uint16_t nibble[16] = {0x0000, 0x1021, 0x2042, 0x3063, 0x4084, 0x50A5, 0x60C6, 0x70E7,
                                        0x8108, 0x9129, 0xA14A, 0xB16B, 0xC18C, 0xD1AD, 0xE1CE, 0xF1EF};
    uint16_t crc = 0xFFFF;
    size_t at;
    for (at = 0; at < length; at++) {
        crc = (uint16_t)((uint16_t)(crc << 4) ^ nibble[(crc >> 12 ^ bytes[at] >> 4) & 0xF]);
        crc = (uint16_t)((uint16_t)(crc << 4) ^ nibble[(crc >> 12 ^ bytes[at]) & 0xF]);
    }
    return crc;
}

size_t drive_stream_encode(uint8_t *plain, size_t length, uint8_t frame[DB_STREAM_MAX_FRAME])
{
    size_t code_at = 0, end = 1, at;
    uint8_t code = 1;
    drive_put16(plain + length, crc16(plain, length));
    for (at = 0; at < length + CRC_BYTES; at++) {
        const bool full = code == 0xFF;
        if (full || plain[at] == 0) {
            frame[code_at] = code;
            code_at = end++;
            code = 1;
        }
        if (plain[at] != 0) {
            frame[end++] = plain[at];
            code++;
        } else if (full) {
            /* The full block before carries no zero: this one is the zero. */
            frame[code_at] = code;
            code_at = end++;
        }
    }
    frame[code_at] = code;
    frame[end++] = 0;
    return end;
}

/* Restores the bytes in place; 0 if a code byte points past the end. */
static size_t decode(uint8_t *bytes, size_t length)
{
    size_t from = 0, to = 0;
    while (from < length) {
        const size_t code = bytes[from], block = code - 1;
        if (from + code > length) {
            return 0;
        }
        memmove(bytes + to, bytes + from + 1, block);
        to += block;
        from += code;
        if (code != 0xFF && from < length) {
            bytes[to++] = 0;
        }
    }
    return to;
}

/* ---- Answers: they are built where the question stood, behind the header --------------------------------------- */

static uint8_t *put32(uint8_t *at, int32_t value)
{
    drive_put32(at, (uint32_t)value);
    return at + 4;
}

static uint8_t *put16(uint8_t *at, uint16_t value)
{
    drive_put16(at, value);
    return at + 2;
}

static uint8_t *put_telemetry(struct drive_slave *slave, uint8_t *at, uint32_t *time_us)
{
    struct drive_telemetry telemetry;
    const struct drive_sample *const sample = &telemetry.sample;
    drive_slave_telemetry(slave, true, &telemetry);
    *time_us = sample->time_us;
    at = put16(at, telemetry.status);
    at = put16(at, telemetry.fault);
    at = put16(at, telemetry.sequence);
    drive_put32(at, telemetry.applied_us);
    at = put32(at + 4, sample->voltage);
    at = put32(at, sample->current);
    at = put32(at, sample->speed);
    at = put32(at, sample->angle);
    at = put32(at, sample->bus_voltage);
    at = put32(at, sample->temperature);
    at = put32(at, sample->voltage_command);
    return put16(at, DB_PROTOCOL_VERSION);
}

static uint8_t *put_identity(const struct drive_slave *slave, uint8_t *at)
{
    uint16_t words[DB_IDENTITY_WORDS];
    size_t word;
    drive_slave_identity(slave, words);
    for (word = 0; word < DB_IDENTITY_WORDS; word++) {
        at = put16(at, words[word]);
    }
    return at;
}

static uint8_t *put_capture_status(const struct drive_slave *slave, uint8_t *at)
{
    at = put16(at, slave->capture_state);
    at = put16(at, slave->capture_count);
    drive_put32(at, slave->capture_us);
    return at + 4;
}

static uint8_t *put_capture_block(const struct drive_slave *slave, uint16_t index, uint8_t *at)
{
    const struct drive_burst *samples = NULL;
    const size_t count = drive_slave_captured(slave, index, DB_STREAM_BLOCK_SAMPLES, &samples);
    size_t sample;
    at = put16(at, index);
    *at++ = (uint8_t)count;
    for (sample = 0; sample < count; sample++) {
        at = put32(at, samples[sample].voltage);
        at = put32(at, samples[sample].current);
        at = put32(at, samples[sample].speed);
    }
    return at;
}

static uint8_t command(struct drive_slave *slave, uint16_t sequence, const uint8_t *payload)
{
    const uint16_t block[DB_COMMAND_WORDS] = {sequence, drive_get16(payload), drive_get16(payload + 2),
                                              drive_get16(payload + 4)};
    if (block[1] > DB_CONTROL_SPEED || drive_get32(payload + 2) == 0x80000000U) {
        return DB_ERROR_BAD_PAYLOAD;
    }
    if (!drive_slave_supports(slave, block[1])) {
        return DB_ERROR_NOT_SUPPORTED;
    }
    drive_slave_command(slave, block);
    return 0;
}

/* Bytes of the payload of each question, by its type. */
static const uint8_t payload_bytes[] = {0, 0, 6, 0, 2, 2, 0, 2};

/* Acts on a question; 0 or the error. */
static uint8_t act(struct drive_slave *slave, uint8_t type, uint16_t sequence, const uint8_t *payload, size_t length)
{
    if (type == 0 || type >= sizeof payload_bytes) {
        return DB_ERROR_UNKNOWN_MESSAGE;
    }
    if (length != payload_bytes[type]) {
        return DB_ERROR_BAD_PAYLOAD;
    }
    switch (type) {
    case DB_MESSAGE_COMMAND:
        return command(slave, sequence, payload);
    case DB_MESSAGE_SET_WATCHDOG:
        return drive_slave_set_watchdog(slave, drive_get16(payload)) ? 0 : DB_ERROR_OUT_OF_RANGE;
    case DB_MESSAGE_CAPTURE_ARM:
        if (drive_get16(payload) > DB_CAPTURE_CONTROL_START) {
            return DB_ERROR_BAD_PAYLOAD;
        }
        return drive_slave_control_capture(slave, drive_get16(payload)) ? 0 : DB_ERROR_NOT_SUPPORTED;
    default:
        return 0;
    }
}

/* Answers the question in the buffer, of `length` bytes without its checksum. */
static size_t answer_question(struct drive_stream *stream, size_t length, uint8_t *answer)
{
    struct drive_slave *const slave = stream->slave;
    uint8_t *const plain = stream->buffer;
    uint8_t *const payload = plain + DB_STREAM_HEADER;
    const uint8_t type = plain[0];
    const uint16_t sequence = drive_get16(plain + 2);
    const uint8_t error = act(slave, type, sequence, payload, length - DB_STREAM_HEADER);
    uint8_t *end = payload;
    uint32_t time_us = 0;
    bool has_time = false;
    if (error != 0) {
        plain[0] = DB_MESSAGE_ERROR;
        *end++ = type;
        *end++ = error;
    } else {
        switch (type) {
        case DB_MESSAGE_COMMAND:
        case DB_MESSAGE_TELEMETRY_REQUEST:
            plain[0] = DB_MESSAGE_TELEMETRY;
            end = put_telemetry(slave, payload, &time_us);
            has_time = true;
            break;
        case DB_MESSAGE_CAPTURE_ARM:
        case DB_MESSAGE_CAPTURE_STATUS_REQUEST:
            plain[0] = DB_MESSAGE_CAPTURE_STATUS;
            end = put_capture_status(slave, payload);
            break;
        case DB_MESSAGE_CAPTURE_REQUEST:
            plain[0] = DB_MESSAGE_CAPTURE_BLOCK;
            end = put_capture_block(slave, drive_get16(payload), payload);
            break;
        default:
            plain[0] = DB_MESSAGE_IDENTITY;
            end = put_identity(slave, payload);
            break;
        }
    }
    if (!has_time) {
        struct drive_sample sample;
        memset(&sample, 0, sizeof sample);
        slave->app->measure(slave->app->context, &sample);
        time_us = sample.time_us;
    }
    drive_put32(plain + 4, time_us);
    return drive_stream_encode(plain, (size_t)(end - plain), answer);
}

void drive_stream_init(struct drive_stream *stream, struct drive_slave *slave)
{
    stream->slave = slave;
    stream->length = 0;
    stream->overflow = false;
}

size_t drive_stream_push(struct drive_stream *stream, uint8_t byte, uint8_t answer[DB_STREAM_MAX_FRAME])
{
    size_t length = stream->length;
    const bool overflow = stream->overflow;
    if (byte != 0) {
        if (length < sizeof stream->buffer) {
            stream->buffer[stream->length++] = byte;
        } else {
            stream->overflow = true;
        }
        return 0;
    }
    stream->length = 0;
    stream->overflow = false;
    if (overflow) {
        return 0;
    }
    length = decode(stream->buffer, length);
    if (length < DB_STREAM_HEADER + CRC_BYTES) {
        return 0;
    }
    length -= CRC_BYTES;
    if (crc16(stream->buffer, length) != drive_get16(stream->buffer + length)) {
        return 0;
    }
    /* Another version, or another drive on the same line: not ours to answer. */
    if (stream->buffer[1] != DB_PROTOCOL_VERSION || (stream->buffer[0] & 0x80) != 0) {
        return 0;
    }
    return answer_question(stream, length, answer);
}

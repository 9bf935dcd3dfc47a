/* Modbus RTU: frames are found by their length and checksum, or end at a silence; requests are answered. */
#include "drive_slave.h"

#include <string.h>

enum {
    READ_HOLDING = 3,
    READ_INPUT = 4,
    WRITE_SINGLE = 6,
    DIAGNOSTICS = 8,
    WRITE_MULTIPLE = 16,
    READ_WRITE = 23,
    ENCAPSULATED = 43,
    DEVICE_IDENTIFICATION = 14
};

#define BROADCAST 0
#define MAX_READ 125
#define MAX_WRITE 123
#define MAX_READ_WRITE_WRITE 121
/* Regular objects, as a stream and one by one. */
#define CONFORMITY 0x82
#define LAST_BASIC_OBJECT 2
#define LAST_REGULAR_OBJECT 6

/* ---- Requests -------------------------------------------------------------------------------------------------- */

/* Gives the exception, or 0 with *length the bytes of the response. */
static uint8_t read_registers(struct drive_slave *slave, const uint8_t *range, uint8_t *response, size_t *length)
{
    const uint16_t address = drive_get16(range), quantity = drive_get16(range + 2);
    if (quantity < 1 || quantity > MAX_READ) {
        return DB_EXCEPTION_ILLEGAL_VALUE;
    }
    if (!drive_map_readable(address, quantity)) {
        return DB_EXCEPTION_ILLEGAL_ADDRESS;
    }
    drive_map_read(slave, address, quantity, response + 2);
    response[1] = (uint8_t)(2 * quantity);
    *length = 2 + 2 * (size_t)quantity;
    return 0;
}

/* `request` begins at the address: address, quantity, byte count, values. */
static uint8_t judge_values(const uint8_t *request, size_t length, uint16_t most)
{
    const uint16_t quantity = drive_get16(request + 2);
    const size_t bytes = 2 * (size_t)quantity;
    if (quantity < 1 || quantity > most || request[4] != bytes || length - 5 != bytes) {
        return DB_EXCEPTION_ILLEGAL_VALUE;
    }
    return 0;
}

static uint8_t read_write(struct drive_slave *slave, const uint8_t *request, size_t length, uint8_t *response,
                          size_t *written)
{
    const uint8_t *const write = request + 5;
    const uint16_t quantity = drive_get16(request + 3);
    uint8_t exception;
    if (quantity < 1 || quantity > MAX_READ) {
        return DB_EXCEPTION_ILLEGAL_VALUE;
    }
    exception = judge_values(write, length - 5, MAX_READ_WRITE_WRITE);
    if (exception != 0) {
        return exception;
    }
    /* Judged before anything is written: a refused request has no effect. */
    if (!drive_map_readable(drive_get16(request + 1), quantity)) {
        return DB_EXCEPTION_ILLEGAL_ADDRESS;
    }
    exception = drive_map_write(slave, drive_get16(write), drive_get16(write + 2), write + 5);
    return exception != 0 ? exception : read_registers(slave, request + 1, response, written);
}

static const char *name_of(const struct drive_slave *slave, unsigned object)
{
    return object < DRIVE_NAMES ? slave->config->names[object] : NULL;
}

/* Device identification: basic and regular as a stream, or one object. */
static uint8_t identify(const struct drive_slave *slave, const uint8_t *request, size_t length, uint8_t *response,
                        size_t *written)
{
    unsigned object, last, next = 0;
    uint8_t number = 0;
    size_t at = 7;
    if (length < 2) {
        return DB_EXCEPTION_ILLEGAL_VALUE;
    }
    if (request[1] != DEVICE_IDENTIFICATION) {
        return DB_EXCEPTION_ILLEGAL_FUNCTION;
    }
    if (length != 4) {
        return DB_EXCEPTION_ILLEGAL_VALUE;
    }
    object = request[3];
    switch (request[2]) {
    case 1:
        last = LAST_BASIC_OBJECT;
        break;
    case 2:
    case 3: /* extended is answered at the drive's own level, regular */
        last = LAST_REGULAR_OBJECT;
        break;
    case 4:
        if (name_of(slave, object) == NULL) {
            return DB_EXCEPTION_ILLEGAL_ADDRESS;
        }
        last = object;
        break;
    default:
        return DB_EXCEPTION_ILLEGAL_VALUE;
    }
    /* A stream that asks for an object that does not exist begins again at object 0. */
    if (object > last || name_of(slave, object) == NULL) {
        object = 0;
    }
    for (; object <= last; object++) {
        const char *const name = name_of(slave, object);
        size_t bytes;
        if (name == NULL) {
            continue;
        }
        bytes = strlen(name);
        if (bytes > DB_MODBUS_MAX_PDU - 9) {
            bytes = DB_MODBUS_MAX_PDU - 9;
        }
        if (at + 2 + bytes > DB_MODBUS_MAX_PDU) {
            next = object;
            break;
        }
        response[at] = (uint8_t)object;
        response[at + 1] = (uint8_t)bytes;
        memcpy(response + at + 2, name, bytes);
        at += 2 + bytes;
        number++;
    }
    response[1] = DEVICE_IDENTIFICATION;
    response[2] = request[2];
    response[3] = CONFORMITY;
    response[4] = next == 0 ? 0 : 0xFF;
    response[5] = (uint8_t)next;
    response[6] = number;
    *written = at;
    return 0;
}

static uint8_t execute(struct drive_slave *slave, const uint8_t *request, size_t length, uint8_t *response,
                       size_t *written)
{
    uint8_t exception;
    switch (request[0]) {
    case READ_HOLDING:
    case READ_INPUT:
        return length == 5 ? read_registers(slave, request + 1, response, written) : DB_EXCEPTION_ILLEGAL_VALUE;
    case WRITE_SINGLE:
        exception =
            length == 5 ? drive_map_write(slave, drive_get16(request + 1), 1, request + 3) : DB_EXCEPTION_ILLEGAL_VALUE;
        break;
    case WRITE_MULTIPLE:
        exception = length >= 6 ? judge_values(request + 1, length - 1, MAX_WRITE) : DB_EXCEPTION_ILLEGAL_VALUE;
        if (exception == 0) {
            exception = drive_map_write(slave, drive_get16(request + 1), drive_get16(request + 3), request + 6);
        }
        break;
    case READ_WRITE:
        return length >= 10 ? read_write(slave, request, length, response, written) : DB_EXCEPTION_ILLEGAL_VALUE;
    case DIAGNOSTICS: /* sub-function 0, return query data */
        if (length < 3) {
            return DB_EXCEPTION_ILLEGAL_VALUE;
        }
        if (drive_get16(request + 1) != 0) {
            return DB_EXCEPTION_ILLEGAL_FUNCTION;
        }
        if (length < 4 || length > DB_MODBUS_MAX_PDU) {
            return DB_EXCEPTION_ILLEGAL_VALUE;
        }
        memcpy(response + 1, request + 1, length - 1);
        *written = length;
        return 0;
    case ENCAPSULATED:
        return identify(slave, request, length, response, written);
    default:
        return DB_EXCEPTION_ILLEGAL_FUNCTION;
    }
    /* The answer to a write is its address and value or quantity. */
    if (exception == 0) {
        memcpy(response + 1, request + 1, 4);
        *written = 5;
    }
    return exception;
}

size_t drive_modbus_respond(struct drive_slave *slave, const uint8_t *request, size_t length,
                            uint8_t response[DB_MODBUS_MAX_PDU])
{
    size_t written = 0;
    uint8_t exception;
    if (length == 0) {
        return 0;
    }
    exception = execute(slave, request, length, response, &written);
    response[0] = request[0];
    if (exception != 0) {
        response[0] |= 0x80;
        response[1] = exception;
        written = 2;
    }
    return written;
}

/* ---- Lengths --------------------------------------------------------------------------------------------------- */

#define NEED_MORE 0
#define UNKNOWN SIZE_MAX

/* The byte at `at` counts the bytes after it. */
static size_t counted(const uint8_t *pdu, size_t have, size_t at)
{
    return have > at ? at + 1 + pdu[at] : NEED_MORE;
}

/* Length of the request that begins so; also of those that are not served, whose end must be known all the same. */
static size_t request_length(const uint8_t *pdu, size_t have)
{
    if (have == 0) {
        return NEED_MORE;
    }
    switch (pdu[0]) {
    case 1: case 2: case 3: case 4: case 5: case 6: case 8:
        return 5;
    case 7: case 11: case 12: case 17:
        return 1;
    case 15: case 16:
        return counted(pdu, have, 5);
    case 20: case 21:
        return counted(pdu, have, 1);
    case 22:
        return 7;
    case 23:
        return counted(pdu, have, 9);
    case 24:
        return 3;
    case 43:
        return have < 2 ? NEED_MORE : pdu[1] == DEVICE_IDENTIFICATION ? 4 : UNKNOWN;
    default:
        return UNKNOWN;
    }
}

/* Length of another slave's answer that begins so. */
static size_t response_length(const uint8_t *pdu, size_t have)
{
    if (have == 0) {
        return NEED_MORE;
    }
    if (pdu[0] >= 128 || pdu[0] == 7) {
        return 2;
    }
    switch (pdu[0]) {
    case 1: case 2: case 3: case 4: case 12: case 17: case 20: case 21: case 23:
        return counted(pdu, have, 1);
    case 5: case 6: case 8: case 11: case 15: case 16:
        return 5;
    case 22:
        return 7;
    case 43: {
        size_t at = 7;
        uint8_t object;
        if (have < 2) {
            return NEED_MORE;
        }
        if (pdu[1] != DEVICE_IDENTIFICATION) {
            return UNKNOWN;
        }
        if (have < 7) {
            return NEED_MORE;
        }
        for (object = 0; object < pdu[6]; object++) {
            if (have <= at + 1) {
                return NEED_MORE;
            }
            at += 2 + (size_t)pdu[at + 1];
        }
        return at;
    }
    default:
        return UNKNOWN;
    }
}

/* ---- Frames ---------------------------------------------------------------------------------------------------- */

static uint16_t crc16(const uint8_t *bytes, size_t length)
{
    static const uint16_t nibble[16] = {0x0000, 0xCC01, 0xD801, 0x1400, 0xF001, 0x3C00, 0x2800, 0xE401,
                                        0xA001, 0x6C00, 0x7800, 0xB401, 0x5000, 0x9C01, 0x8801, 0x4400};
    uint16_t crc = 0xFFFF;
    size_t at;
    for (at = 0; at < length; at++) {
        crc = (uint16_t)(crc >> 4 ^ nibble[(crc ^ bytes[at]) & 0xF]);
        crc = (uint16_t)(crc >> 4 ^ nibble[(crc ^ bytes[at] >> 4) & 0xF]);
    }
    return crc;
}

void drive_modbus_init(struct drive_modbus *modbus, struct drive_slave *slave, uint8_t unit)
{
    modbus->slave = slave;
    modbus->unit = unit;
    modbus->gap = false;
    modbus->length = 0;
}

static void drop(struct drive_modbus *modbus, size_t bytes)
{
    modbus->length -= bytes;
    memmove(modbus->buffer, modbus->buffer + bytes, modbus->length);
}

void drive_modbus_push(struct drive_modbus *modbus, uint8_t byte)
{
    if (modbus->length == sizeof modbus->buffer) {
        drop(modbus, 1); /* nobody asked for an answer: the oldest goes */
    }
    modbus->buffer[modbus->length++] = byte;
    modbus->gap = false;
}

void drive_modbus_idle(struct drive_modbus *modbus)
{
    modbus->gap = true;
}

enum fit { FITS, WAIT, NO };

/* Whether the buffer begins with a frame whose PDU has this length; *bytes is then the frame's. */
static enum fit fit(const struct drive_modbus *modbus, size_t pdu, size_t *bytes)
{
    size_t frame = DB_RTU_MAX_FRAME;
    if (pdu == UNKNOWN) {
        frame = modbus->gap ? modbus->length : DB_RTU_MAX_FRAME;
    } else if (pdu > DB_MODBUS_MAX_PDU) {
        return NO;
    } else if (pdu != NEED_MORE) {
        frame = pdu + 3;
    }
    if (frame > modbus->length) {
        return modbus->gap ? NO : WAIT;
    }
    *bytes = frame;
    /* The checksum over a frame with its checksum is 0. */
    return frame >= 4 && crc16(modbus->buffer, frame) == 0 ? FITS : NO;
}

size_t drive_modbus_answer(struct drive_modbus *modbus, uint8_t answer[DB_RTU_MAX_FRAME])
{
    while (modbus->length > 0) {
        const uint8_t unit = modbus->buffer[0];
        const uint8_t *const pdu = modbus->buffer + 1;
        const bool ours = unit == modbus->unit || unit == BROADCAST;
        size_t bytes = 0;
        enum fit found = fit(modbus, request_length(pdu, modbus->length - 1), &bytes);
        if (found == FITS && ours) {
            const size_t length = drive_modbus_respond(modbus->slave, pdu, bytes - 3, answer + 1);
            drop(modbus, bytes);
            if (unit != BROADCAST && length > 0) {
                const size_t end = 1 + length;
                uint16_t crc;
                answer[0] = unit;
                crc = crc16(answer, end);
                answer[end] = (uint8_t)(crc & 0xFF);
                answer[end + 1] = (uint8_t)(crc >> 8);
                return end + 2;
            }
            continue;
        }
        if (!ours && found != FITS) {
            /* On a shared line the answers of the other drives come by too. */
            const enum fit foreign = fit(modbus, response_length(pdu, modbus->length - 1), &bytes);
            if (foreign != NO || found == NO) {
                found = foreign;
            }
        }
        if (found == WAIT) {
            return 0;
        }
        /* A whole frame for another unit; or no frame begins here, and the search goes on at the next byte. */
        drop(modbus, found == FITS ? bytes : 1);
    }
    return 0;
}

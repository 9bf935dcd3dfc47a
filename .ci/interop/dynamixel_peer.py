"""The maker's library for Dynamixel (dynamixel-sdk) as host, and a servo on its codec.

  dynamixel_peer.py check PATH    our software servo dynamixel-xm430: ping, PWM mode, goal, watchdog latched and cleared
  dynamixel_peer.py serve PATH    an XM430 at rest, 12 V, at a position whose bytes have to be stuffed
"""

import struct
import sys
import time

import serial
from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, PacketHandler, PortHandler
from dynamixel_sdk.protocol2_packet_handler import ERRNUM_ACCESS, ERRNUM_DATA_RANGE

MODE, TORQUE, WATCHDOG, GOAL, DUTY, SPEED = 11, 64, 98, 100, 124, 128
HANDLER = PacketHandler(2.0)


def expect(right, what, *reply):
    if not right:
        sys.exit(f"dynamixel_peer: {what}: {reply}")


def check(where):
    port = PortHandler(where)
    expect(port.openPort() and port.setBaudRate(57600), f"cannot open {where}")

    def write(size, address, value, error=0):
        call = {1: HANDLER.write1ByteTxRx, 2: HANDLER.write2ByteTxRx}[size]
        reply = call(port, 1, address, value & 0xFFFF)
        expect(reply == (COMM_SUCCESS, error), f"write of {value} at {address}", *reply)

    def read(size, address):
        call = {1: HANDLER.read1ByteTxRx, 2: HANDLER.read2ByteTxRx, 4: HANDLER.read4ByteTxRx}[size]
        value, *reply = call(port, 1, address)
        expect(reply == [COMM_SUCCESS, 0], f"read at {address}", *reply)
        return value - (value >> 8 * size - 1 << 8 * size)

    model, *reply = HANDLER.ping(port, 1)
    expect(model == 1030 and reply == [COMM_SUCCESS, 0], "ping", model, *reply)
    _, result, _ = HANDLER.ping(port, 2)
    expect(result == COMM_RX_TIMEOUT, "another id answers", result)
    for size, address, value in ((1, TORQUE, 0), (1, WATCHDOG, 0), (1, MODE, 16), (2, GOAL, 0)):
        write(size, address, value)
        expect(read(size, address) == value, "read back", address)
    write(1, WATCHDOG, 10)
    write(1, TORQUE, 1)
    write(2, DUTY, 0, ERRNUM_ACCESS)
    for goal in (300, -300):
        write(2, GOAL, goal)
        end = time.monotonic() + 0.6
        while time.monotonic() < end:
            duty, speed = read(2, DUTY), read(4, SPEED)
        expect(abs(duty - goal) <= 3 and speed * goal > 0, "follows its goal", goal, duty, speed)
    time.sleep(0.5)
    expect(read(1, WATCHDOG) == -1, "the watchdog stops it after 0.2 s", read(1, WATCHDOG))
    expect(abs(read(2, DUTY)) <= 3, "no voltage then", read(2, DUTY))
    write(2, GOAL, 300, ERRNUM_DATA_RANGE)
    write(1, WATCHDOG, 0)
    write(2, GOAL, 0)
    write(1, TORQUE, 0)
    port.closePort()


def serve(where):
    table = bytearray(147)
    for address, value, kind in (
        (0, 1030, "H"), (6, 45, "B"), (7, 1, "B"), (36, 885, "H"), (38, 1193, "H"), (132, 0xFDFFFF, "i"),
        (144, 120, "H"), (146, 31, "B"),
    ):  # fmt: skip
        struct.pack_into("<" + kind, table, address, value)
    line = serial.Serial(where, 57600)
    while True:
        packet = list(line.read(7))
        packet += line.read(packet[5] + 256 * packet[6])
        crc = HANDLER.updateCRC(0, packet, len(packet) - 2)
        expect(packet[-2:] == [crc & 255, crc >> 8], "check sum", packet)
        packet = HANDLER.removeStuffing(packet)
        expect(packet[4] == 1 and packet[7] in (1, 2), "only ping and reads come", packet)
        struct.pack_into("<H", table, 120, int(time.monotonic() * 1000) % 32768)
        if packet[7] == 1:
            data = [*table[0:2], table[6]]
        else:
            address, count = struct.unpack("<HH", bytes(packet[8:12]))
            data = table[address : address + count]
        reply = [0xFF, 0xFF, 0xFD, 0, 1, len(data) + 4, 0, 0x55, 0, *data, 0, 0]
        reply = HANDLER.addStuffing(reply)
        crc = HANDLER.updateCRC(0, reply, reply[5] + 5)
        line.write(bytes(reply[: reply[5] + 5]) + struct.pack("<H", crc))


if __name__ == "__main__":
    {"serve": serve, "check": check}[sys.argv[1]](sys.argv[2])

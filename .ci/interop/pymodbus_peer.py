"""pymodbus as server and as client.

  pymodbus_peer.py serve rtu PATH | serve tcp PORT    200 holding registers of 7 i + 3, 200 input registers of i
  pymodbus_peer.py check rtu PATH | check tcp PORT    our software drive, register by register (SPEC.md)
"""

import sys

from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.datastore import ModbusSequentialDataBlock, ModbusServerContext

try:
    from pymodbus.datastore import ModbusDeviceContext
except ImportError:
    from pymodbus.datastore import ModbusSlaveContext as ModbusDeviceContext
from pymodbus.framer import FramerType
from pymodbus.server import StartSerialServer, StartTcpServer


def serve(kind, where):
    # The first address of a block is one above that of the protocol.
    device = ModbusDeviceContext(
        hr=ModbusSequentialDataBlock(1, [7 * i + 3 for i in range(200)]),
        ir=ModbusSequentialDataBlock(1, list(range(200))),
    )
    context = ModbusServerContext(device, single=True)
    if kind == "tcp":
        StartTcpServer(context=context, address=("127.0.0.1", int(where)))
    else:
        StartSerialServer(context=context, framer=FramerType.RTU, port=where, baudrate=115200)


def expect(right, what, reply=None):
    if not right:
        sys.exit(f"pymodbus_peer: {what}: {reply}")


def check(kind, where):
    if kind == "tcp":
        client = ModbusTcpClient("127.0.0.1", port=int(where), timeout=5)
    else:
        client = ModbusSerialClient(where, framer=FramerType.RTU, baudrate=115200, timeout=5)
    expect(client.connect(), f"cannot connect to {where}")
    reply = client.read_holding_registers(64, count=17)
    expect(not reply.isError() and reply.registers[0] == 0x4442, "identity", reply)
    expect(reply.registers[2] & 1 == 1, "the emulator says what it is", reply)
    for number in range(1, 21):
        reply = client.readwrite_registers(
            read_address=0, read_count=16, write_address=32, values=[number, 1, 0, 0]
        )
        expect(not reply.isError(), "function code 23", reply)
        expect(reply.registers[2] == number, "echo of the sequence number", reply.registers)
    for values in (700, 750):
        reply = client.write_register(73, values)
        expect(not reply.isError(), "function code 6", reply)
        reply = client.write_registers(73, [values + 1])
        expect(not reply.isError(), "function code 16", reply)
        reply = client.read_holding_registers(73, count=1)
        expect(reply.registers == [values + 1], "read back", reply)
    for reply, code in (
        (client.read_holding_registers(60000, count=1), 2),
        (client.write_register(73, 1), 3),
    ):
        expect(reply.isError() and reply.exception_code == code, f"exception {code}", reply)
    client.close()


if __name__ == "__main__":
    {"serve": serve, "check": check}[sys.argv[1]](sys.argv[2], sys.argv[3])

#!/usr/bin/env bash
# Our host against the servers of pymodbus and libmodbus, our software drive against the clients of mbpoll, pymodbus
# and libmodbus, over RTU and TCP; servo and host of Dynamixel against the library of its maker; what our taps recorded is
# read by tshark, the Parquet of a run by pyarrow.
#
#   .ci/interop/run.sh PROGRAM
#
# Installs its peers where they are missing. Where that is impossible (no network, not root) it says aloud that nothing
# was checked, and ends well; with DRIVEBENCH_REQUIRE_INTEROP=1 it fails.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
# shellcheck source=.ci/install.sh
. "$here/../install.sh"
program=$(realpath "${1:?usage: run.sh PROGRAM}")
work=$(mktemp -d)
children=()
finish() {
    for child in "${children[@]}"; do kill "$child" 2>/dev/null || true; done
    wait 2>/dev/null || true
    rm -rf "$work"
}
trap finish EXIT

passed=0
pass() { passed=$((passed + 1)); echo "ok   $1"; }
fail() { echo "FAIL $1" >&2; exit 1; }

missing() {
    for tool in mbpoll socat tshark gcc pkg-config; do
        command -v "$tool" >/dev/null || echo "$tool"
    done
    pkg-config --exists libmodbus 2>/dev/null || echo libmodbus-dev
    python3 -c 'import venv, ensurepip' 2>/dev/null || echo python3-venv
}

install_peers() {
    if [ -n "$(missing)" ]; then
        apt_install libmodbus-dev mbpoll socat tshark gcc libc6-dev pkg-config python3-venv || return
    fi
    [ -z "$(missing)" ] || return 1
    python3 -m venv "$work/venv"
    tried timeout 240 "$work/venv/bin/pip" install -q --disable-pip-version-check \
        'pymodbus==3.16.1' 'pyserial==3.5' 'pyarrow==26.0.1'
}

if ! install_peers; then
    echo "the peers cannot be installed here: $(missing | tr '\n' ' ')" >&2
    if [ "${DRIVEBENCH_REQUIRE_INTEROP:-0}" = 1 ]; then
        echo "help: install them, or unset DRIVEBENCH_REQUIRE_INTEROP to go on without" >&2
        exit 1
    fi
    echo "interoperability is NOT checked" >&2
    exit 0
fi

read -ra modbus_flags <<<"$(pkg-config --cflags --libs libmodbus)"
for name in lm_server lm_client; do
    gcc -O2 -Wall -Wextra -Werror "$here/$name.c" -o "$work/$name" "${modbus_flags[@]}"
done
python="$work/venv/bin/python"

# A loaded machine only takes longer.
until_true() {
    for _ in $(seq 300); do
        if "$@" 2>/dev/null; then return 0; fi
        sleep 0.1
    done
    fail "waited too long for: $*"
}
listens() { (exec 3<>"/dev/tcp/127.0.0.1/$1") 2>/dev/null; }
free_port() { "$python" -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])'; }
start() { "$@" >>"$work/log" 2>&1 & children+=($!); }
pair() {
    start socat "pty,raw,echo=0,link=$1" "pty,raw,echo=0,link=$2"
    until_true test -e "$1"
    until_true test -e "$2"
}

# --- our host, their servers -----------------------------------------------------------------------------------------

# host_all NAME LINK-OPTIONS...: reads, input registers, a refusal, writes of one and of three, a tap, the doctor.
host_all() {
    local name=$1
    shift
    local line=(--timeout-ms 5000 "$@")
    local out status=0
    out=$("$program" registers read 0:5 10 75:125 "${line[@]}" --tap "$work/$name.pcap" --json) || fail "$name: read: $out"
    "$python" - "$out" <<'CHECK' || fail "$name: values: $out"
import json, sys
result = json.loads(sys.argv[1])
for read, (address, count) in zip(result["reads"], ((0, 5), (10, 1), (75, 125)), strict=True):
    assert read == {"address": address, "values": [7 * (address + i) + 3 for i in range(count)]}, read
c = result["counters"]
assert c["sent"] == sum(c[k] for k in ("ok", "timeout", "crc", "stale", "mismatch", "exception", "aborted")), c
assert c["ok"] >= 3 and c["timeout"] == c["crc"] == c["stale"] == c["mismatch"] == c["aborted"] == 0, c
CHECK
    pass "$name: holding registers"
    out=$("$program" registers read 3:4 --input "${line[@]}" --json) || fail "$name: input: $out"
    "$python" -c 'import json, sys; assert json.loads(sys.argv[1])["reads"][0]["values"] == [3, 4, 5, 6]' "$out" ||
        fail "$name: input registers: $out"
    pass "$name: input registers"
    out=$("$program" registers read 5000 "${line[@]}" --json) || status=$?
    [ "$status" = 3 ] || fail "$name: a refused read ends in $status"
    [[ $out == *0x02* ]] || fail "$name: the refusal is not named: $out"
    pass "$name: exception 2"
    out=$("$program" registers write 150 4711 "${line[@]}" --yes --hardware --json) || fail "$name: write: $out"
    out=$("$program" registers write 151 1 2 65535 "${line[@]}" --yes --hardware --tap "$work/$name-write.pcap" --json) ||
        fail "$name: write of three: $out"
    out=$("$program" registers read 150:4 "${line[@]}" --json)
    "$python" -c 'import json, sys; assert json.loads(sys.argv[1])["reads"][0]["values"] == [4711, 1, 2, 65535]' "$out" ||
        fail "$name: written values: $out"
    pass "$name: function codes 6 and 16, read back"
    out=$("$program" registers read 0:10 --repeat 200 "${line[@]}" --gap-us 0 --json) || fail "$name: repeated: $out"
    pass "$name: 200 reads without a gap"
    out=$("$program" doctor "${line[@]}" --json) || fail "$name: doctor: $out"
    pass "$name: doctor"
}

start "$work/lm_server" pty "$work/lm.pty"
until_true test -e "$work/lm.pty"
host_all libmodbus-rtu --port "$work/lm.pty"
port=$(free_port)
start "$work/lm_server" tcp "$port"
until_true listens "$port"
host_all libmodbus-tcp --host "127.0.0.1:$port"
libmodbus_port=$port

pair "$work/py-host" "$work/py-server"
start "$python" "$here/pymodbus_peer.py" serve rtu "$work/py-server"
until_true "$program" registers read 0 --port "$work/py-host" --timeout-ms 200
host_all pymodbus-rtu --port "$work/py-host"
port=$(free_port)
start "$python" "$here/pymodbus_peer.py" serve tcp "$port"
until_true listens "$port"
host_all pymodbus-tcp --host "127.0.0.1:$port"
pymodbus_port=$port

# --- their clients, our software drive -------------------------------------------------------------------------------

start "$program" emulate --link modbus-rtu --pty "$work/drive.pty"
until_true test -e "$work/drive.pty"
port=$(free_port)
start "$program" emulate --link modbus-tcp --listen "127.0.0.1:$port"
until_true listens "$port"
drive_port=$port

polled() { [[ $1 == *"[64]:"*17474* ]] || fail "$2: $1"; }
out=$(mbpoll -m rtu -b 115200 -P none -a 1 -0 -t 4 -r 64 -c 5 -o 5 -1 "$work/drive.pty") || fail "mbpoll rtu: $out"
polled "$out" "mbpoll rtu"
pass "mbpoll -> drive, RTU"
out=$(mbpoll -m tcp -p "$drive_port" -a 1 -0 -t 4 -r 64 -c 5 -o 5 -1 127.0.0.1) || fail "mbpoll tcp: $out"
polled "$out" "mbpoll tcp"
pass "mbpoll -> drive, TCP"
out=$(mbpoll -m rtu -b 115200 -P none -a 1 -0 -t 4 -r 73 -o 5 "$work/drive.pty" 800) || fail "mbpoll write: $out"
out=$("$program" registers read 73 --port "$work/drive.pty" --json)
[[ $out == *800* ]] || fail "mbpoll write: $out"
pass "mbpoll writes, RTU"
for peer in rtu:"$work/drive.pty" tcp:"$drive_port"; do
    kind=${peer%%:*} where=${peer#*:}
    "$work/lm_client" check "$kind" "$where" || fail "libmodbus client, $kind"
    pass "libmodbus -> drive, $kind"
    "$python" "$here/pymodbus_peer.py" check "$kind" "$where" || fail "pymodbus client, $kind"
    pass "pymodbus -> drive, $kind"
done

# --- Dynamixel: the maker's library drives our servo, our host reads a servo on the maker's codec --------------------------

if tried timeout 120 "$work/venv/bin/pip" install -q --disable-pip-version-check 'dynamixel-sdk==4.1.0'; then
    start "$program" emulate --profile dynamixel-xm430 --pty "$work/servo.pty"
    until_true test -e "$work/servo.pty"
    "$python" "$here/dynamixel_peer.py" check "$work/servo.pty" || fail "dynamixel-sdk -> servo"
    pass "dynamixel-sdk -> servo: PWM mode, goal, refusals, watchdog"
    pair "$work/dx-host" "$work/dx-servo"
    start "$python" "$here/dynamixel_peer.py" serve "$work/dx-servo"
    probe=("$program" probe --drive dynamixel-xm430 --port "$work/dx-host" --json)
    until_true "${probe[@]}" >"$work/log"
    "${probe[@]}" >"$work/probe.json" || fail "probe of a servo: $(<"$work/probe.json")"
    "$python" - "$work/probe.json" <<'CHECK' || fail "probe of a servo: $(<"$work/probe.json")"
import json, sys
probe = json.load(open(sys.argv[1], encoding="utf-8"))
values = {own["name"]: own["value"] for own in probe["signals"]}
assert probe["verdict"] == "plausible", probe["verdict"]
assert (values["model"], values["input_voltage"], values["position"]) == (1030, 12, 0xFDFFFF), values
CHECK
    pass "probe reads a servo on the codec of dynamixel-sdk, stuffing included"
else
    echo "dynamixel-sdk cannot be installed: Dynamixel is NOT checked against it"
    [ "${DRIVEBENCH_REQUIRE_INTEROP:-0}" != 1 ] || exit 1
fi

# --- our host and our drive, as the bench uses them: function code 23 ------------------------------------------------

# A machine that stands still for half a second ends a run with status 3 or 4, as it must; the frames are there all the same.
status=0
"$program" run --headless --port "$work/drive.pty" --out "$work/runs" --tap "$work/run.pcap" --json >"$work/run.json" ||
    status=$?
case $status in 0 | 3 | 4) ;; *) fail "a run over the tapped link: status $status" ;; esac

# --- what the taps say, read by tshark -------------------------------------------------------------------------------

# dissect FILE PROTOCOL PORT: function codes, one a line. A frame that makes no sense ends it.
dissect() {
    local options=(-r "$1")
    if [ "$2" = rtu ]; then
        options+=(-o 'uat:user_dlts:"User 0 (DLT=147)","mbrtu","0","","0",""')
    else
        options+=(-d "tcp.port==$3,mbtcp")
    fi
    local bad
    bad=$(tshark "${options[@]}" -Y '_ws.malformed || _ws.expert.group == "Checksum" || mbrtu.crc16.status == 0 || tcp.checksum.status == 0' 2>"$work/tshark.log" | wc -l)
    [ "$bad" = 0 ] || fail "$1: $bad malformed frames"
    tshark "${options[@]}" -T fields -e modbus.func_code 2>"$work/tshark.log"
}

# expect_codes NAME FILE PROTOCOL PORT CODE...: exactly these function codes, and every frame has one.
expect_codes() {
    local name=$1 file=$2 protocol=$3 port=$4
    shift 4
    local codes
    codes=$(dissect "$file" "$protocol" "$port") || exit 1
    [ -n "$codes" ] || fail "$name: the capture is empty"
    local seen expected
    seen=$(sort -nu <<<"$codes" | tr '\n' ' ')
    expected=$(printf '%s\n' "$@" | sort -nu | tr '\n' ' ')
    [ "$seen" = "$expected" ] || fail "$name: function codes $seen, expected $expected"
    pass "$name: tshark reads $(wc -l <<<"$codes") frames, function codes $seen"
}

expect_codes libmodbus-rtu "$work/libmodbus-rtu.pcap" rtu 0 3
expect_codes pymodbus-rtu "$work/pymodbus-rtu.pcap" rtu 0 3
expect_codes libmodbus-rtu-write "$work/libmodbus-rtu-write.pcap" rtu 0 3 16
expect_codes pymodbus-rtu-write "$work/pymodbus-rtu-write.pcap" rtu 0 3 16
expect_codes libmodbus-tcp "$work/libmodbus-tcp.pcap" tcp "$libmodbus_port" 3
expect_codes pymodbus-tcp "$work/pymodbus-tcp.pcap" tcp "$pymodbus_port" 3
expect_codes libmodbus-tcp-write "$work/libmodbus-tcp-write.pcap" tcp "$libmodbus_port" 3 16
run_codes=$(dissect "$work/run.pcap" rtu 0) || exit 1
grep -qx 23 <<<"$run_codes" || fail "the run's capture has no function code 23"
pass "run: tshark reads $(wc -l <<<"$run_codes") frames, function code 23 among them"

# --- the samples of a run as columns, read by pyarrow ----------------------------------------------------------------

# Only a program that was built with the feature writes them.
if "$program" run --headless --port sim: --parquet --out "$work/columns" --json >"$work/columns.json" 2>"$work/log"; then
    for run in "$work"/columns/*-*/ "$work"/runs/*-*/; do
        columns="$run/samples.parquet"
        [ -e "$columns" ] || "$program" export --run "$run" --to parquet --output "$columns" >"$work/log" ||
            fail "export of $run"
        out=$("$python" "$here/parquet_peer.py" "$run/samples.csv" "$columns" 2>&1) || fail "parquet: $out"
        pass "pyarrow reads $out"
    done
elif grep -q 'built without Parquet' "$work/log"; then
    pass 'Parquet is refused: the program was built without --features parquet, and pyarrow reads nothing'
else
    fail "a run with --parquet: $(<"$work/log")"
fi

echo
echo "interop: $passed passed, 0 failed"

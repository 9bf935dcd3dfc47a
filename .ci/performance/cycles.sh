#!/usr/bin/env bash
# Missed cycles at 1 kHz over the stream without a pace, beside a plain C loop: interleaved rounds against the same
# emulator. Not run by .ci/run: it measures, and needs a quiet machine.
#
#   .ci/performance/cycles.sh PROGRAM [SECONDS] [ROUNDS] [RATE_HZ]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(realpath "$here/../..")
program=$(realpath "${1:?usage: cycles.sh PROGRAM [SECONDS] [ROUNDS] [RATE_HZ]}")
seconds=${2:-10} rounds=${3:-10} rate=${4:-1000}
work=$(mktemp -d)
server=
trap '[ -z "$server" ] || kill "$server" 2>/dev/null; rm -rf "$work"' EXIT
gcc -O2 -I"$root/firmware-protocol/c" -I"$root/firmware-protocol/include" "$here/stream_loop.c" \
    "$root"/firmware-protocol/c/drive_stream.c "$root"/firmware-protocol/c/drive_map.c -o "$work/stream_loop"
# A machine that stands still for a moment is to miss cycles, not to end the run.
sed 's/^watchdog_ms = .*/watchdog_ms = 1000/' "$root/bench-configs/emulators/zk-22fc-plain.toml" >"$work/emulator.toml"
printf '\n[line]\nbaud = 0\nturnaround_ms = 0.0\n' >>"$work/emulator.toml"
cat >"$work/bench.toml" <<TOML
name = "cycles"
drive = { profile = "own-stream" }
link = { port = "$work/pty", protocol = "stream", rate_hz = $rate }
motor = { name = "ZK-22FC", rated_voltage_v = 110.0, rated_current_a = 5.7, rated_speed_rad_s = 293.2, resistance_ohm = 1.1, inductance_h = 0.0099, back_emf_v_s_per_rad = 0.3538, inertia_kg_m2 = 0.0045, load_torque_n_m = 0.455 }
limits = { link_silence_s = 0.95 }
sequence = [{ standstill = { seconds = $seconds } }]
TOML
"$program" emulate "$work/emulator.toml" --link stream --pty "$work/pty" >/dev/null &
server=$!
until [ -e "$work/pty" ]; do sleep 0.1; done
ours() {
    "$program" run "$work/bench.toml" --headless --out "$work/runs" >"$work/out" 2>&1 || { cat "$work/out" >&2; return 1; }
    local manifest
    manifest=$(find "$work/runs" -name manifest.json -newer "$work/mark" | head -n 1)
    python3 - "$manifest" <<'PY'
import json, sys
m = json.load(open(sys.argv[1]))
sent = m["link_statistics"]["sent"]
print(sent, m["missed_cycles"], sent - m["link_statistics"]["ok"],
      round(1e6 * m["lateness_p50_s"], 1), round(1e6 * m["lateness_p99_s"], 1))
PY
}
theirs() { "$work/stream_loop" "$work/pty" "$rate" "$seconds"; }
for ((round = 1; round <= rounds; round++)); do
    touch "$work/mark"; sleep 0.05
    # Who goes first changes from round to round.
    if ((round % 2)); then a=$(ours) b=$(theirs); else b=$(theirs) a=$(ours); fi
    echo "$a $b" >>"$work/rows"
    echo "round $round: ours $a | plain C $b   (cycles, missed, lost, lateness p50 us, p99 us)"
done
python3 - "$work/rows" <<'SUM'
import sys
rows = [[float(x) for x in line.split()] for line in open(sys.argv[1])]
ours, plain = (sum(r[1] for r in rows) / sum(r[0] + r[1] for r in rows), sum(r[6] for r in rows) / sum(r[5] + r[6] for r in rows))
print(f"missed: ours {100 * ours:.3f} % of the cycles, plain C {100 * plain:.3f} % (target: no more than the plain loop)")
ratios = sorted(r[4] / r[9] for r in rows if r[9] > 0)
p99 = [sorted(r[k] for r in rows)[len(rows) // 2] for k in (4, 9)]
print(f"lateness: 99 % below {p99[0]:.0f} us, plain C {p99[1]:.0f} us (median round); ratio {ratios[len(ratios) // 2]:.2f}, {ratios[0]:.2f} to {ratios[-1]:.2f} (target: at most 1.3)")
print(f"lost: ours {sum(r[2] for r in rows):.0f}, plain C {sum(r[7] for r in rows):.0f}")
SUM

#!/usr/bin/env bash
# Round trips per second beside libmodbus: ten interleaved rounds over a direct pseudo-terminal, same server, same
# registers, same affinity. Not run by .ci/run: it measures, and needs a quiet machine.
#
#   .ci/performance/rates.sh PROGRAM [READS] [ROUNDS]
#
# Prints each round, then the ratios and the targets: rate >= 0.9 of libmodbus without a gap, 99th percentile
# <= 1.2 of its, and with the standard's gap of 1.75 ms within 5 % of what the gap and the exchange itself allow.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
program=$(realpath "${1:?usage: rates.sh PROGRAM [READS] [ROUNDS]}")
reads=${2:-20000} rounds=${3:-10} gapped=2000
work=$(mktemp -d)
server=
trap '[ -z "$server" ] || kill "$server" 2>/dev/null; rm -rf "$work"' EXIT
read -ra flags <<<"$(pkg-config --cflags --libs libmodbus)"
for name in lm_server lm_client; do gcc -O2 "$here/../interop/$name.c" -o "$work/$name" "${flags[@]}"; done
# The server has one processor and the client another, where there are two.
last=$(($(nproc) - 1))
taskset -c 0 "$work/lm_server" pty "$work/pty" >/dev/null &
server=$!
until [ -e "$work/pty" ]; do sleep 0.1; done
ours() {
    taskset -c "$last" "$program" registers read 0:10 --port "$work/pty" --repeat "$1" --gap-us "$2" --json |
        python3 -c 'import json, sys; r = json.load(sys.stdin); print("%.0f %.1f %.1f" % (r["rate_hz"], r["p50_us"], r["p99_us"]))'
}
theirs() { taskset -c "$last" "$work/lm_client" rate "$work/pty" "$1" "$2"; }
for ((round = 1; round <= rounds; round++)); do
    # Who goes first changes from round to round.
    if ((round % 2)); then
        a=$(ours "$reads" 0) b=$(theirs "$reads" 0)
    else
        b=$(theirs "$reads" 0) a=$(ours "$reads" 0)
    fi
    c=$(ours "$gapped" 1750) d=$(theirs "$gapped" 1750)
    echo "$a $b $c $d" >>"$work/rows"
    echo "round $round: ours $a | libmodbus $b | with gap: ours $c | libmodbus $d   (rate, p50 us, p99 us)"
done
python3 - "$work/rows" <<'SUM'
import statistics, sys
columns = list(zip(*[[float(x) for x in line.split()] for line in open(sys.argv[1])]))
m = [statistics.median(c) for c in columns]
print(f"no gap: ours {m[0]:.0f}/s, libmodbus {m[3]:.0f}/s, ratio {m[0] / m[3]:.3f} (target: 0.9)")
print(f"no gap: p50 {m[1]:.1f} / {m[4]:.1f} us, p99 {m[2]:.1f} / {m[5]:.1f} us, ratio {m[2] / m[5]:.2f} (target: at most 1.2)")
limit = 1e6 / (1750 + m[7])
print(f"gap 1750 us: ours {m[6]:.0f}/s, libmodbus {m[9]:.0f}/s, limit 1/(gap + p50) {limit:.0f}/s: {100 * (1 - m[6] / limit):.1f} % below (target: 5 %)")
print(f"gap 1750 us: of the gap alone, {1e6 / 1750:.0f}/s: {100 * (1 - m[6] * 1750e-6):.1f} % below")
SUM

#!/usr/bin/env bash
# Everything about speed in one go, on a machine with nothing else to do: the benchmarks, then others beside us in interleaved
# rounds, then docs/benchmarks.md anew. Not run by CI, whose machines are noisy; that counts instructions.
#
#   .ci/performance/run.sh [ROUNDS]
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/../.."
# shellcheck source=.ci/install.sh
. .ci/install.sh
rounds=${1:-10}
target=${CARGO_TARGET_DIR:-target}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

cargo build --release
cargo bench
kernel=$("$here/kernel.sh")
gcc -O2 "$here/rls.c" -o "$work/rls"
for peer in numpy pandas pyarrow; do
    python3 -c "import $peer" 2>/dev/null || pip_install "$peer" || echo "not compared with $peer"
done
peers=$target/criterion/peers.txt
python3 "$here/peers.py" "$target/release/drivebench" "$kernel" "$work" "$rounds" >"$work/peers.txt"
"$here/cycles.sh" "$target/release/drivebench" 10 "$rounds" | tee "$work/cycles"
{
    cat "$work/peers.txt"
    echo
    sed -n '/^missed:\|^lost:\|^lateness:/s/^/- 1 kHz over our stream, beside a plain C loop: /p' "$work/cycles"
    if pkg-config --exists libmodbus 2>/dev/null; then
        "$here/rates.sh" "$target/release/drivebench" 20000 "$rounds" >"$work/rates"
        sed -n '/^no gap:\|^gap/s/^/- Modbus RTU, beside libmodbus: /p' "$work/rates"
    fi
} >"$peers"
cargo bench --bench table

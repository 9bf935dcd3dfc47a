#!/usr/bin/env bash
# Builds the benchmark `kernel` and prints where it is.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
cargo bench --no-run --bench kernel --message-format json --quiet |
    python3 -c '
import json, sys
for line in sys.stdin:
    made = json.loads(line)
    if made.get("executable") and made["target"]["name"] == "kernel":
        print(made["executable"])'

# The tasks of a day; `just` lists them.
_default:
    @just --list

# The main job on the embedded software drive
run *arguments:
    cargo run --release -- commission {{ arguments }}

# The tests, as the README promises them
test:
    cargo test --workspace --release

# Format and lints, as CI wants them
lint:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets --release -- -D warnings
    typos

# Everything that must hold before a change goes in
ci:
    .ci/run

# Licences, advisories and sources of the dependencies
deny:
    cargo deny check

# How often the diagnosis is right, written into docs/validation; half an hour on two cores
validation:
    cargo run --release -p drivebench-studies -- discovery --out target/validation
    cp target/validation/tables.md docs/validation/tables.md

# Speed, written into docs/benchmarks.md
bench:
    cargo bench

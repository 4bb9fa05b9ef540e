# Short names for the everyday commands; `just` alone lists them.

_default:
    @just --list

# Formatting and lints, as CI asks for them.
check:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets --locked -- -D warnings

# Every test; those on shared recordings need LUMISCAN_SHARED.
test *ARGS:
    cargo test --workspace --locked {{ARGS}}

# Every benchmark.
bench *ARGS:
    cargo bench --workspace --locked {{ARGS}}

# The main job on a recording.
replay SOURCE="recordings/data/tabletop.lrec" *ARGS:
    cargo run --release --locked -p capture --bin lumiscan -- replay {{SOURCE}} {{ARGS}}

# All of CI.
ci:
    .ci/run

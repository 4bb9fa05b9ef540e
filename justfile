# Short names for the everyday commands; `just` alone lists them.

_default:
    @just --list

# Formatting and lints, as CI asks for them.
check:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets --locked -- -D warnings

# Every test; those that need LUMISCAN_SHARED are ignored where it is not set.
test *ARGS:
    cargo test --workspace --locked {{ARGS}}

# The documentation of every crate; warnings are errors.
doc:
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --locked

# Every benchmark.
bench *ARGS:
    cargo bench --workspace --locked {{ARGS}}

# Writes the tables of the documents, or those named, by running what measures them.
figures *NAMES:
    python3 .readme/figures.py {{NAMES}}

# The main job on a recording.
replay SOURCE="recordings/data/tabletop.lrec" *ARGS:
    cargo run --release --locked -p capture --bin lumiscan -- replay {{SOURCE}} {{ARGS}}

# All of CI.
ci:
    .ci/run

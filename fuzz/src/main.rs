//! One executable for every target: libFuzzer's `main`, and the environment variable `FUZZ_TARGET`, which names the target.
//! `fuzz/run` builds it with coverage counters and runs it.

#![no_main]

mod heap;
mod scratch;
mod targets;

use std::sync::OnceLock;
use targets::Target;

static TARGET: OnceLock<Target> = OnceLock::new();

libfuzzer_sys::fuzz_target!(
    init: {
        let name = std::env::var("FUZZ_TARGET").unwrap_or_default();
        let Some(target) = targets::find(&name) else {
            eprintln!("FUZZ_TARGET must be one of {}", targets::names().join(", "));
            std::process::exit(2);
        };
        let _ = TARGET.set(target);
        heap::spare_reports();
    },
    |data: &[u8]| {
        if let Some(target) = TARGET.get() {
            heap::limited(target.most_bytes, || (target.run)(data));
        }
    }
);

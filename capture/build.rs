//! Commit and target of the executable, for `lumiscan --version`; and what `../tests/build.rs` does.

#[path = "../tests/build.rs"]
mod tests;

use std::process::Command;

fn main() {
    tests::main();
    println!("cargo:rerun-if-env-changed=LUMISCAN_COMMIT");
    let git = |args: &[&str]| {
        let output = Command::new("git").args(args).output().ok().filter(|o| o.status.success())?;
        String::from_utf8(output.stdout).ok().map(|text| text.trim().to_owned())
    };
    // Sources without their history are built with the variable.
    let commit = std::env::var("LUMISCAN_COMMIT").ok().or_else(|| {
        println!("cargo:rerun-if-changed={}", git(&["rev-parse", "--git-path", "logs/HEAD"])?);
        git(&["rev-parse", "--short=12", "HEAD"])
    });
    println!("cargo:rustc-env=LUMISCAN_COMMIT={}", commit.as_deref().unwrap_or("unknown commit"));
    println!("cargo:rustc-env=LUMISCAN_TARGET={}", std::env::var("TARGET").unwrap_or_default());
}

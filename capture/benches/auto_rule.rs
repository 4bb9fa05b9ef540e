//! How the automatic choice of models fares against its rule: error at most 1.1 × the best of the sweep, in at most twice the
//! time of the cheapest setting that comes so near. Prints one line a scene.
//!
//!     cargo bench -p capture --bench auto_rule -- [SCENES]

use std::process::{Command, ExitCode, Stdio};

fn main() -> ExitCode {
    let table = std::env::temp_dir().join(format!("lumiscan-auto-rule-{}.csv", std::process::id()));
    let scenes = std::env::args().skip(1).filter(|a| !a.starts_with("--"));
    // Benches start in their package's folder; scenes are named from the workspace's.
    let answer = Command::new(env!("CARGO_BIN_EXE_lumiscan"))
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .arg("trade")
        .args(scenes)
        .arg("-o")
        .arg(&table)
        .stderr(Stdio::inherit())
        .output();
    let Ok(answer) = answer else { return ExitCode::FAILURE };
    for line in String::from_utf8_lossy(&answer.stdout).lines().filter(|l| l.contains(" the rule: ")) {
        println!("{line}");
    }
    // A file that is not there needs no removing.
    let _ = std::fs::remove_file(&table);
    let _ = std::fs::remove_file(table.with_extension("png"));
    if answer.status.success() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

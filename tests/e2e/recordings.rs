//! `import tum`, `export --to tum`, `inspect` of recordings, and their messages about damaged ones.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{arg, fails, json, ok, run, text, tum_folder};
use std::path::Path;

const FRAMES: usize = 4;

/// A TUM folder and the recording made from it, as arguments.
fn recording(dir: &Path) -> (String, String) {
    let (folder, file) = (dir.join("desk"), dir.join("desk.lrec"));
    tum_folder(&folder, FRAMES);
    assert_eq!(ok(&["import", "tum", &arg(&folder), "-o", &arg(&file)]).trim(), arg(&file));
    (arg(folder), arg(file))
}

#[test]
fn a_tum_folder_comes_back_frame_for_frame() {
    let dir = tempfile::tempdir().unwrap();
    let (folder, file) = recording(dir.path());
    let back = arg(dir.path().join("back"));
    assert_eq!(ok(&["export", &file, "--to", "tum", "-o", &back]).trim(), back);
    let lists = |folder: &str, name: &str| -> Vec<(String, String)> {
        let text = std::fs::read_to_string(Path::new(folder).join(name)).unwrap();
        let lines = text.lines().filter(|l| !l.starts_with('#'));
        lines.filter_map(|l| l.split_once(' ')).map(|(t, f)| (t.to_owned(), f.to_owned())).collect()
    };
    for list in ["rgb.txt", "depth.txt"] {
        let (before, after) = (lists(&folder, list), lists(&back, list));
        assert_eq!(before.len(), FRAMES);
        assert_eq!(after.len(), FRAMES);
        for ((t0, f0), (t1, f1)) in before.iter().zip(&after) {
            assert_eq!(t0, t1);
            let pixels = |folder: &str, file: &str| {
                let file = std::io::BufReader::new(std::fs::File::open(Path::new(folder).join(file)).unwrap());
                let mut reader = png::Decoder::new(file).read_info().unwrap();
                let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
                reader.next_frame(&mut bytes).unwrap();
                bytes
            };
            assert_eq!(pixels(&folder, f0), pixels(&back, f1), "{f0}");
        }
    }
    assert!(fails(2, &["export", &file, "--to", "tum", "-o", &back]).contains("name a new one"));
}

#[test]
fn inspect_counts_what_a_recording_holds() {
    let dir = tempfile::tempdir().unwrap();
    let (_, file) = recording(dir.path());
    // What a file is, is read from its contents.
    let renamed = dir.path().join("without-extension");
    std::fs::copy(&file, &renamed).unwrap();
    let summary = json(&["inspect", &arg(&renamed), "--json"]);
    assert_eq!(summary["kind"], "recording");
    let seconds = summary["duration_s"].as_f64().unwrap();
    assert!((seconds - (FRAMES as f64 - 1.0) / 30.0 - 0.004).abs() < 1e-4, "{seconds}");
    for stream in ["depth", "color"] {
        let expected = serde_json::json!({ "frames": FRAMES, "incomplete": 0, "missing_packets": 0 });
        assert_eq!(summary[stream], expected);
    }
    assert!(ok(&["inspect", &file]).contains("duration_s"));
}

#[test]
fn damaged_recordings_are_3_for_every_command() {
    let dir = tempfile::tempdir().unwrap();
    let (_, file) = recording(dir.path());
    let whole = std::fs::read(&file).unwrap();
    let device = arg(dir.path().join("device"));
    let damaged = dir.path().join("damaged.lrec");
    let mut cases: Vec<(String, Vec<u8>)> = vec![("empty".into(), vec![])];
    for share in [1, 30, 60, 99] {
        cases.push((format!("cut at {share} %"), whole[..whole.len() * share / 100].to_vec()));
        let mut flipped = whole.clone();
        let at = flipped.len() * share / 100;
        flipped[at] ^= 0x10;
        cases.push((format!("flipped at {share} %"), flipped));
    }
    for (case, bytes) in cases {
        std::fs::write(&damaged, bytes).unwrap();
        let path = arg(&damaged);
        for args in [&["inspect", &path][..], &["replay", &path, "--device", &device, "--no-estimate"]] {
            let output = run(args);
            let stderr = text(&output.stderr);
            assert_eq!(output.status.code(), Some(3), "{case}: {args:?}: {stderr}");
            assert!(stderr.contains("damaged.lrec"), "{case}: {stderr}");
        }
        assert_eq!(common::scans(Path::new(&device)), Vec::<String>::new(), "{case}");
    }
}

#[test]
fn what_is_no_recording_is_3() {
    let dir = tempfile::tempdir().unwrap();
    let note = dir.path().join("note.lrec");
    std::fs::write(&note, "just a text that is long enough to hold a header").unwrap();
    let device = arg(dir.path().join("device"));
    for args in [
        &["inspect", &arg(&note)][..],
        &["inspect", "/nowhere.lrec"],
        &["export", &arg(&note), "--to", "tum", "-o", &arg(dir.path().join("out"))],
        &["replay", &arg(&note), "--device", &device],
        &["replay", "/nowhere", "--device", &device],
        &["import", "tum", "/nowhere", "-o", &arg(dir.path().join("x.lrec"))],
        &["import", "photos", "/nowhere", "-o", &arg(dir.path().join("x.lscan"))],
        &["estimate", &arg(&note)],
        &["export", &arg(&note), "--to", "folder", "-o", &arg(dir.path().join("out"))],
    ] {
        let message = fails(3, args);
        assert!(message.contains("note.lrec") || message.contains("/nowhere"), "{args:?}: {message}");
    }
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "only the note itself");
}

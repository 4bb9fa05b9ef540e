//! Small files of every version, kept so that what was once written stays readable.

use crate::decision::{Cut, Decision, DecisionText};
use crate::local_light::LocalLight;
use crate::recording::{Event, RecordingKind, RecordingReader, RecordingWriter};
use crate::result::{Estimate, Origin};
use crate::scan::Scan;
use crate::testing::{bumpy_mesh, estimate_on, events, packets, scan, sensor};
use std::path::{Path, PathBuf};

fn samples() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data/samples")
}

fn write(dir: &Path) {
    let recordings =
        [("v1-frames.lrec", RecordingKind::Frames, events(2)), ("v1-packets.lrec", RecordingKind::Packets, packets(5))];
    for (name, kind, events) in recordings {
        let mut writer = RecordingWriter::create(&dir.join(name), kind, &sensor()).unwrap();
        events.iter().for_each(|e| writer.write(e).unwrap());
        writer.finish().unwrap();
    }
    scan().write(&dir.join("v1.lscan")).unwrap();
    estimate_on(bumpy_mesh(6)).write(&dir.join("v1-findings.lres")).unwrap();
    estimate_on(bumpy_mesh(6)).write_from(&dir.join("v1-origin.lres"), Some(&origin())).unwrap();
}

fn origin() -> Origin {
    Origin { scan: "01".repeat(32), settings: "ef".repeat(32), version: "0.1.0".into() }
}

/// Only for a new version, under new names: what is there must never change.
#[test]
#[ignore = "writes the samples: cargo test -p recordings write_samples -- --ignored"]
fn write_samples() {
    write(&samples());
}

#[test]
fn version_1_is_still_read() {
    let read = |name: &str| -> Vec<Event> {
        let mut reader = RecordingReader::open(&samples().join(name)).unwrap();
        assert_eq!(reader.sensor(), &sensor());
        std::iter::from_fn(|| reader.next_event().unwrap()).collect()
    };
    assert_eq!(read("v1-frames.lrec"), events(2));
    assert_eq!(read("v1-packets.lrec"), packets(5));
    assert_eq!(Scan::read(&samples().join("v1.lscan")).unwrap(), scan());
    let result = Estimate::read(&samples().join("v1.lres")).unwrap();
    let expected = estimate_on(bumpy_mesh(6));
    assert_eq!(
        (&result.segment, &result.segments, &result.light),
        (&expected.segment, &expected.segments, &expected.light)
    );
    assert_eq!((&result.keyframes, result.transfer), (&expected.keyframes, expected.transfer));
    // This file is from before decisions had costs, and before they were typed.
    let text = DecisionText {
        name: "bands".into(),
        choice: "3".into(),
        evidence: "held-out error 0.01".into(),
        cost: String::new(),
        next_level: "0.0099".into(),
    };
    assert_eq!(result.decisions, [Decision::Text(text)]);
    assert_eq!((result.cuts, result.warnings), (vec![Cut::Text("bounces".into())], vec![]));
    for (a, b) in result.mesh.positions.iter().zip(&expected.mesh.positions) {
        assert!((a - b).length() < 2e-5);
    }
    for (a, b) in result.albedo.iter().zip(&expected.albedo) {
        assert!((a - b).length() < 0.002);
    }
}

/// The first file with decisions, cuts and warnings as figures: one of every kind.
#[test]
fn findings_are_still_read() {
    let result = Estimate::read(&samples().join("v1-findings.lres")).unwrap();
    let expected = estimate_on(bumpy_mesh(6));
    // This file is from before the model of light and the scale of the albedo were decisions.
    let newer = |d: &Decision| matches!(d, Decision::LightModel { .. } | Decision::AlbedoScale { .. });
    let older = expected.decisions.into_iter().filter(|d| !newer(d));
    assert_eq!(result.decisions, older.collect::<Vec<_>>());
    assert_eq!(result.local_light, LocalLight::default());
    assert_eq!((result.cuts, result.warnings), (expected.cuts, expected.warnings));
}

/// The first file that tells what it was made from.
#[test]
fn origins_are_still_read() {
    let path = samples().join("v1-origin.lres");
    assert_eq!(Origin::read(&path).unwrap(), Some(origin()));
    assert_eq!(Estimate::read(&path).unwrap().segments, estimate_on(bumpy_mesh(6)).segments);
    assert_eq!(Origin::read(&samples().join("v1.lres")).unwrap(), None);
}

//! Input that cannot be used: a message that names the file and the remedy, the exit code, and a device folder in which
//! nothing half-written appears and earlier scans stay as they are.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{SIZE, arg, fails, ok, scans, tum_folder, write_png};
use std::path::{Path, PathBuf};

const FRAMES: usize = 12;

/// A device folder with one finished scan in it, which has to stay as it is.
struct Device {
    dir: tempfile::TempDir,
    before: Vec<(PathBuf, Vec<u8>)>,
}

impl Device {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let source = dir.path().join("good");
        tum_folder(&source, FRAMES);
        let device = arg(dir.path().join("device"));
        ok(&["replay", &arg(&source), "--device", &device, "--no-estimate", "--set", "fusion.voxel_size_m=0.01"]);
        let before = contents(&dir.path().join("device"));
        Self { dir, before }
    }

    /// Replays `source`, which has to fail with `code`, and returns the message.
    fn refuses(&self, code: i32, source: &Path) -> String {
        let device = self.dir.path().join("device");
        let message = fails(code, &["replay", &arg(source), "--device", &arg(&device), "--rounds", "1"]);
        assert!(contents(&device) == self.before, "the device folder is as it was");
        assert_eq!(scans(&device).len(), 1);
        message
    }

    /// A good TUM folder, made bad.
    fn spoilt(&self, name: &str, spoil: impl FnOnce(&Path)) -> PathBuf {
        let folder = self.dir.path().join(name);
        tum_folder(&folder, FRAMES);
        spoil(&folder);
        folder
    }
}

fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(contents(&path))
        } else {
            found.push((path.clone(), std::fs::read(path).unwrap()))
        }
    }
    found.sort();
    found
}

fn truncate(path: &Path, share: f64) {
    let bytes = std::fs::read(path).unwrap();
    std::fs::write(path, &bytes[..(bytes.len() as f64 * share) as usize]).unwrap();
}

#[test]
fn folders_that_are_no_recording_are_3() {
    let device = Device::new();
    assert!(device.refuses(3, Path::new("/nowhere")).contains("/nowhere"));
    let empty = device.dir.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    assert!(device.refuses(3, &empty).contains("rgb.txt"));
    for list in ["rgb.txt", "depth.txt", "camera.txt"] {
        let folder = device.spoilt(&format!("missing-{list}"), |f| std::fs::remove_file(f.join(list)).unwrap());
        assert!(device.refuses(3, &folder).contains(list));
        let folder = device.spoilt(&format!("empty-{list}"), |f| std::fs::write(f.join(list), "# nothing\n").unwrap());
        assert!(device.refuses(3, &folder).contains(list));
    }
}

#[test]
fn pictures_that_cannot_be_read_are_3() {
    let device = Device::new();
    for picture in ["rgb/7.png", "depth/7.png"] {
        for share in [0.0, 0.5, 0.98] {
            let name = format!("cut-{}-{share}", picture.replace('/', "-"));
            let folder = device.spoilt(&name, |f| truncate(&f.join(picture), share));
            let message = device.refuses(3, &folder);
            assert!(message.contains(&name) && message.contains("replace"), "{message}");
        }
        let folder = device.spoilt(&picture.replace('/', "-gone-"), |f| std::fs::remove_file(f.join(picture)).unwrap());
        assert!(device.refuses(3, &folder).contains(picture));
    }
}

#[test]
fn sizes_that_do_not_agree_are_3() {
    let device = Device::new();
    let half = |w: u32, h: u32, bytes: usize| vec![100u8; (w * h) as usize * bytes];
    let small = |path: &Path, color, bits, data: &[u8]| {
        // As many bytes as before, but half as high.
        let file = std::fs::File::create(path).unwrap();
        let mut encoder = png::Encoder::new(file, SIZE.0, SIZE.1 / 2);
        encoder.set_color(color);
        encoder.set_depth(bits);
        encoder.write_header().unwrap().write_image_data(data).unwrap();
    };
    let folder = device.spoilt("small-depth", |f| {
        let data = half(SIZE.0, SIZE.1 / 2, 2);
        small(&f.join("depth/3.png"), png::ColorType::Grayscale, png::BitDepth::Sixteen, &data);
    });
    assert!(device.refuses(3, &folder).contains("depth/3.png"));
    let folder = device.spoilt("small-color", |f| {
        small(&f.join("rgb/3.png"), png::ColorType::Rgb, png::BitDepth::Eight, &half(SIZE.0, SIZE.1 / 2, 3));
    });
    assert!(device.refuses(3, &folder).contains("rgb/3.png"));
}

#[test]
fn scans_in_which_tracking_never_holds_are_4() {
    let device = Device::new();
    let blind = device.spoilt("blind", |f| {
        let nothing = vec![0u8; (SIZE.0 * SIZE.1) as usize * 2];
        for i in 0..FRAMES {
            let path = f.join(format!("depth/{i}.png"));
            write_png(&path, png::ColorType::Grayscale, png::BitDepth::Sixteen, &nothing);
        }
    });
    assert!(device.refuses(4, &blind).contains("scan again"));
    let apart = device.spoilt("apart", |f| {
        let list = std::fs::read_to_string(f.join("depth.txt")).unwrap();
        std::fs::write(f.join("depth.txt"), list.replace("\n100", "\n200")).unwrap();
    });
    assert!(device.refuses(4, &apart).contains("max_pair_gap_ms"));
}

#[test]
fn device_folders_that_cannot_be_written_are_said() {
    let device = Device::new();
    let file = device.dir.path().join("file");
    std::fs::write(&file, "").unwrap();
    let source = arg(device.dir.path().join("good"));
    assert!(fails(1, &["replay", &source, "--device", &arg(&file), "--no-estimate"]).contains("--device"));
}

#[test]
fn damaged_scans_and_results_are_3() {
    let device = Device::new();
    let (_, scan) = device.before.iter().find(|(p, _)| p.ends_with("scan.lscan")).unwrap();
    let dir = device.dir.path();
    let good = dir.join("good.lscan");
    std::fs::write(&good, scan).unwrap();
    ok(&["estimate", &arg(&good), "--rounds", "1"]);
    let result = std::fs::read(dir.join("good.lres")).unwrap();

    let out = dir.join("out");
    for (name, whole) in [("bad.lscan", scan), ("bad.lres", &result)] {
        let file = dir.join(name);
        let mut cases: Vec<Vec<u8>> =
            [0.0, 0.01, 0.5, 0.999].map(|s| whole[..(whole.len() as f64 * s) as usize].to_vec()).into();
        for share in [0.001, 0.3, 0.7, 0.99] {
            let mut flipped = whole.clone();
            flipped[(whole.len() as f64 * share) as usize] ^= 4;
            cases.push(flipped);
        }
        for bytes in cases {
            std::fs::write(&file, bytes).unwrap();
            assert!(fails(3, &["inspect", &arg(&file)]).contains(name));
            if name == "bad.lscan" {
                assert!(fails(3, &["estimate", &arg(&file)]).contains(name));
                assert!(!dir.join("bad.lres").exists());
            } else {
                for form in ["folder", "ply", "hdr"] {
                    assert!(fails(3, &["export", &arg(&file), "--to", form, "-o", &arg(&out)]).contains(name));
                    assert!(!out.exists());
                }
            }
        }
    }
    // The wrong kind of file.
    assert!(fails(3, &["estimate", &arg(dir.join("good.lres"))]).contains("good.lres"));
    assert!(fails(3, &["export", &arg(&good), "--to", "ply", "-o", &arg(&out)]).contains("good.lscan"));
    assert!(fails(3, &["replay", &arg(&good), "--device", &arg(dir.join("device"))]).contains("good.lscan"));
}

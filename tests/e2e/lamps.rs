//! Results with lamps: `lumiscan render` lights, shades and changes them, and says what it cannot do. The lamps are put into
//! the result of a small scan by hand: finding them is tested elsewhere.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{arg, fails, middle_of, ok, scanned_table};
use recordings::local_light::{Emitter, Lamp, LightModel, LocalLight};
use recordings::result::Estimate;
use recordings::types::RgbImage;
use std::path::PathBuf;
use std::sync::OnceLock;

const QUICK: [&str; 12] = [
    "--view",
    "keyframe:0",
    "--set",
    "reality.vertex_rays=16",
    "--set",
    "reality.pixel_rays=16",
    "--set",
    "reality.pixel_samples=4",
    "--set",
    "reality.relight_rays=16",
    "--set",
    "reality.object_rays=8",
];

/// A published scan, its result, the same with a lamp above the table, and the same with a surface that emits.
struct Lit {
    dir: PathBuf,
    plain: String,
    lamp: String,
    emitter: String,
    estimate: Estimate,
}

static LIT: OnceLock<Lit> = OnceLock::new();

fn lit() -> &'static Lit {
    LIT.get_or_init(|| {
        let (dir, scan) = scanned_table("lamps");
        for file in ["scan.lscan", "result.lres"] {
            std::fs::copy(scan.join(file), dir.join(file)).unwrap();
        }
        let estimate = Estimate::read(&dir.join("result.lres")).unwrap();
        let write = |name: &str, light: LocalLight| {
            Estimate { local_light: light, ..estimate.clone() }.write(&dir.join(name)).unwrap();
            std::fs::copy(scan.join("scan.lscan"), dir.join(name).with_extension("lscan")).unwrap();
            arg(dir.join(name))
        };
        // A lamp 40 cm above the middle of the scan, several times as bright as all else.
        let middle = middle_of(&estimate);
        let level = estimate.light.coefficients[0].map(|c| c * 0.282);
        let radiance = level.map(|l| 4.0 * l * (0.4 / 0.05f64).powi(2));
        let lamp = Lamp { center: (middle + glam::Vec3::Z * 0.4).to_array(), radius_m: 0.05, radiance };
        let lamp = LocalLight { model: LightModel::Lamps, lamps: vec![lamp], ..LocalLight::default() };
        let near = |p: &glam::Vec3| p.distance(middle) < 0.05;
        let vertices = (0u32..).zip(&estimate.mesh.positions).filter(|(_, p)| near(p)).map(|(i, _)| i).collect();
        let emitters = vec![Emitter { vertices, radiance: level.map(|l| 0.2 * l) }];
        let emitter = LocalLight { model: LightModel::Emitters, emitters, ..LocalLight::default() };
        let (lamp, emitter) = (write("lamp.lres", lamp), write("emitter.lres", emitter));
        Lit { plain: arg(dir.join("result.lres")), lamp, emitter, dir, estimate }
    })
}

impl Lit {
    fn render(&self, result: &str, name: &str, options: &[&str]) -> RgbImage {
        let out = self.dir.join(name);
        ok(&[&["render", result, "-o", &arg(&out)], &QUICK[..], options].concat());
        RgbImage::decode(&std::fs::read(out).unwrap()).unwrap()
    }

    fn refuses(&self, result: &str, options: &[&str]) -> String {
        let out = self.dir.join("refused.png");
        let message = fails(2, &[&["render", result, "-o", &arg(&out)], options].concat());
        assert!(!out.exists());
        message
    }
}

fn brightness(picture: &RgbImage) -> f64 {
    picture.data.iter().map(|v| f64::from(*v)).sum::<f64>() / picture.data.len() as f64
}

/// The same of 6 × 6 pixels in the middle.
fn middle_brightness(picture: &RgbImage) -> f64 {
    let (w, h) = (picture.width as usize, picture.height as usize);
    let around = (h / 2 - 3..h / 2 + 3).flat_map(|y| (w / 2 - 3..w / 2 + 3).map(move |x| y * w + x));
    around.map(|i| picture.data[3 * i..3 * i + 3].iter().map(|v| f64::from(*v)).sum::<f64>()).sum::<f64>() / 108.0
}

#[test]
fn lamps_are_switched_dimmed_coloured_and_moved() {
    let s = lit();
    let with = |name: &str, change: &str| s.render(&s.lamp, name, &["--lamp", change]);
    let (off, half, twice) = (with("off.png", "0=off"), with("half.png", "0=*0.5"), with("twice.png", "0=*2"));
    assert!(brightness(&off) + 3.0 < brightness(&half) && brightness(&half) + 3.0 < brightness(&twice));
    let blue = with("blue.png", "0=*0,0,1");
    let mean = |p: &RgbImage, c: usize| p.data.iter().skip(c).step_by(3).map(|v| f64::from(*v)).sum::<f64>();
    assert!(mean(&blue, 0) <= mean(&off, 0), "red of the lamp is left");
    assert!(mean(&blue, 2) > mean(&off, 2));
    // Moved far away it lights as little as one that is off.
    let away = with("away.png", "0=@0,0,500");
    assert!((brightness(&away) - brightness(&off)).abs() < 0.5, "{} {}", brightness(&away), brightness(&off));
    // The same over the photo, where a lamp that is brighter brightens.
    let over = |name: &str, change: &str| s.render(&s.lamp, name, &["--over", "photo", "--lamp", change]);
    assert!(brightness(&over("over-off.png", "0=off")) + 3.0 < brightness(&over("over-twice.png", "0=*2")));
    // A change that changes nothing leaves the photo as it is.
    let photo = s.render(&s.lamp, "photo.png", &["--over", "photo"]);
    assert_eq!(s.render(&s.lamp, "on.png", &["--over", "photo", "--lamp", "0=on"]).data, photo.data);
}

#[test]
fn under_another_light_lamps_are_off_unless_named() {
    let s = lit();
    ok(&["export", &s.plain, "--to", "hdr", "-o", &arg(s.dir.join("light.hdr"))]);
    let light = arg(s.dir.join("light.hdr"));
    let other = ["--exposure", "1", "--light", light.as_str()];
    let without = s.render(&s.plain, "other.png", &other);
    assert_eq!(s.render(&s.lamp, "other-lamp.png", &other).data, without.data);
    let named = s.render(&s.lamp, "other-on.png", &[&other[..], &["--lamp", "0=on"]].concat());
    assert!(brightness(&named) > brightness(&without) + 3.0);
}

#[test]
fn what_is_inserted_shades_the_table_from_the_lamp() {
    let s = lit();
    // A plate of 6 × 6 cm half way between the lamp and the table.
    let mut ply =
        String::from("ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n");
    ply += "element face 2\nproperty list uchar int vertex_indices\nend_header\n";
    ply += "-0.03 -0.03 0\n0.03 -0.03 0\n0.03 0.03 0\n-0.03 0.03 0\n3 0 1 2\n3 0 2 3\n";
    std::fs::write(s.dir.join("plate.ply"), ply).unwrap();
    let [x, y, z] = middle_of(&s.estimate).to_array();
    let insert = format!("{}@{x},{y},{}", arg(s.dir.join("plate.ply")), z + 0.2);
    let shadow = |result: &str, name: &str| {
        let over = ["--over", "photo"];
        let before = s.render(result, &format!("before-{name}"), &over);
        let after = s.render(result, name, &[&over[..], &["--insert", &insert]].concat());
        // The plate itself stands higher in the picture.
        middle_brightness(&after) / middle_brightness(&before)
    };
    let (plain, lamp) = (shadow(&s.plain, "plain-plate.png"), shadow(&s.lamp, "lamp-plate.png"));
    assert!(plain > 0.9 && lamp < 0.85, "without lamp {plain}, with lamp {lamp}");
}

#[test]
fn surfaces_that_emit_are_dimmed() {
    let s = lit();
    let with = |name: &str, change: &str| middle_brightness(&s.render(&s.emitter, name, &["--emitter", change]));
    let (off, half, twice) = (with("e-off.png", "0=off"), with("e-half.png", "0=*0.5"), with("e-twice.png", "0=*2"));
    assert!(off + 3.0 < half && half + 3.0 < twice, "{off} {half} {twice}");
}

#[test]
fn changes_that_make_no_sense_are_2() {
    let s = lit();
    assert!(s.refuses(&s.lamp, &["--lamp", "1=off"]).contains("lamp 0"));
    assert!(s.refuses(&s.plain, &["--lamp", "0=off"]).contains("no lamps"));
    assert!(s.refuses(&s.lamp, &["--emitter", "0=off"]).contains("no emitters"));
    assert!(s.refuses(&s.emitter, &["--emitter", "0=@1,2,3"]).contains("cannot be moved"));
    for text in ["off", "0=", "0=half", "0=*-1", "0=@1,2", "0=*1,2", "x=off"] {
        assert!(s.refuses(&s.lamp, &["--lamp", text]).contains("--lamp"), "{text}");
    }
}

//! `lumiscan render`: every kind of view, change, light and output, together and alone, on a small scan; and input that
//! makes no sense.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "these are tests")]

mod common;

use common::{SIZE, arg, fails, middle_of, ok, run, scanned_table, text};
use recordings::result::Estimate;
use recordings::scan::Scan;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Few rays: what is tested here is what comes out where, not how smooth it is.
const QUICK: [&str; 14] = [
    "--set",
    "reality.vertex_rays=16",
    "--set",
    "reality.change_rays=16",
    "--set",
    "reality.object_rays=8",
    "--set",
    "reality.pixel_change_rays=8",
    "--set",
    "reality.pixel_rays=16",
    "--set",
    "reality.pixel_samples=4",
    "--set",
    "reality.relight_rays=16",
];

/// A scan of a table with two balls, and objects to insert.
struct Scanned {
    dir: PathBuf,
    estimate: Estimate,
    scan: Scan,
}

static SCANNED: OnceLock<Scanned> = OnceLock::new();

fn scanned() -> &'static Scanned {
    SCANNED.get_or_init(|| {
        let (dir, folder) = scanned_table("render");
        for file in ["scan.lscan", "result.lres"] {
            std::fs::copy(folder.join(file), dir.join(file)).unwrap();
        }
        let estimate = Estimate::read(&dir.join("result.lres")).unwrap();
        let scan = Scan::read(&dir.join("scan.lscan")).unwrap();
        std::fs::write(dir.join("box.ply"), box_ply(0.04)).unwrap();
        Scanned { dir, estimate, scan }
    })
}

impl Scanned {
    fn path(&self, name: &str) -> String {
        arg(self.dir.join(name))
    }

    /// Renders with `options` into `name` and returns the output's path.
    fn render(&self, name: &str, options: &[&str]) -> PathBuf {
        let out = self.path(name);
        assert_eq!(ok(&[&["render", &self.path("result.lres"), "-o", &out], &QUICK[..], options].concat()).trim(), out);
        out.into()
    }

    /// A rendering that has to fail with `code`, and leaves nothing behind.
    fn refuses(&self, code: i32, options: &[&str]) -> String {
        let folder = self.dir.join("refused");
        let _ = std::fs::create_dir(&folder);
        let out = arg(folder.join("out.png"));
        let message = fails(code, &[&["render", &self.path("result.lres"), "-o", &out], &QUICK[..], options].concat());
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0, "nothing half-written");
        message
    }

    /// Where the middle of keyframe 0 meets the scan, as an option's value.
    fn middle(&self) -> String {
        let p = middle_of(&self.estimate);
        format!("{},{},{}", p.x, p.y, p.z)
    }

    /// The picture of keyframe 0, as the scan holds it.
    fn photo(&self) -> Vec<u8> {
        self.scan
            .keyframes
            .iter()
            .find(|k| k.name == self.estimate.keyframes[0].name)
            .unwrap()
            .color
            .decode()
            .unwrap()
            .data
    }
}

/// A cube on its foot, with an edge of `size` metres, in ASCII.
fn box_ply(size: f32) -> String {
    let mut text =
        String::from("ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n");
    text += "element face 12\nproperty list uchar int vertex_indices\nend_header\n";
    for i in 0..8 {
        let at = |bit: i32| if i >> bit & 1 == 1 { size / 2.0 } else { -size / 2.0 };
        let _ = writeln!(text, "{} {} {}", at(0), at(1), at(2) + size / 2.0);
    }
    for [a, b, c, d] in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
        let _ = writeln!(text, "3 {a} {b} {c}\n3 {a} {c} {d}");
    }
    text
}

/// Size and pixels of a PNG file.
fn png(path: &Path) -> ((u32, u32), Vec<u8>) {
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path).unwrap())).read_info().unwrap();
    let mut data = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut data).unwrap();
    ((info.width, info.height), data)
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A panorama whose right half (azimuth over 180°) is bright.
fn panorama(path: &Path, width: u32, height: u32) {
    let data: Vec<u8> =
        (0..width * height).flat_map(|i| if i % width >= width / 2 { [250, 240, 230] } else { [40, 45, 50] }).collect();
    let mut encoder = png::Encoder::new(std::fs::File::create(path).unwrap(), width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(&data).unwrap();
}

/// Differing pixels of two pictures of the same size.
fn changed(a: &[u8], b: &[u8]) -> Vec<usize> {
    assert_eq!(a.len(), b.len());
    (0..a.len() / 3).filter(|i| a[3 * i..3 * i + 3] != b[3 * i..3 * i + 3]).collect()
}

fn has_ffmpeg() -> bool {
    let found = std::process::Command::new("ffmpeg").arg("-version").output().is_ok_and(|o| o.status.success());
    if !found {
        eprintln!("skipped: ffmpeg is not on the PATH, which videos go through");
    }
    found
}

#[test]
fn every_kind_of_view_and_output() {
    let s = scanned();
    assert_eq!(png(&s.render("keyframe.png", &["--view", "keyframe:0"])).0, SIZE);
    assert_eq!(png(&s.render("small.png", &["--view", "keyframe:0", "--size", "80x60"])).0, (80, 60));
    let all = s.render("all", &["--view", "all", "--size", "40x30"]);
    assert_eq!(names(&all).len(), s.estimate.keyframes.len());
    assert_eq!(names(&all)[0], "000.png");
    assert_eq!(names(&s.render("orbit", &["--view", "orbit:3", "--size", "40x30"])), ["000.png", "001.png", "002.png"]);
    if !s.scan.witnesses.is_empty() {
        assert_eq!(png(&s.render("witness.png", &["--view", "witness:0"])).0, SIZE);
    }

    // The same camera from a file gives the same picture, but for the keyframe's gain.
    let k = &s.estimate.keyframes[0];
    let (i, rows) = (k.camera.intrinsics, k.world_from_camera.to_rows());
    let opengl = rows.map(|r| [r[0], -r[1], -r[2], r[3]]);
    let json = serde_json::json!({ "w": i.width, "h": i.height, "fl_x": i.fx, "fl_y": i.fy, "cx": i.cx, "cy": i.cy,
        "frames": [{ "transform_matrix": [opengl[0], opengl[1], opengl[2], [0.0, 0.0, 0.0, 1.0]] }] });
    std::fs::write(s.dir.join("view.json"), json.to_string()).unwrap();
    let from_file = png(&s.render("file.png", &["--view", &s.path("view.json")])).1;
    let gain = k.gain[1].to_string();
    let keyframe = png(&s.render("same.png", &["--view", &s.path("view.json"), "--exposure", &gain])).1;
    let there = png(&s.dir.join("keyframe.png")).1;
    let green = |p: &[u8]| p.iter().skip(1).step_by(3).map(|v| f64::from(*v)).sum::<f64>();
    assert!((green(&keyframe) / green(&there) - 1.0).abs() < 0.01, "{} {}", green(&keyframe), green(&there));
    let brighter = png(&s.render("bright.png", &["--view", &s.path("view.json"), "--exposure", "2"])).1;
    assert!(green(&brighter) > 1.2 * green(&from_file));

    let exr = std::fs::read(s.render("linear.exr", &["--view", "keyframe:0", "--size", "40x30"])).unwrap();
    assert!(exr.starts_with(&[0x76, 0x2f, 0x31, 0x01]));
    if has_ffmpeg() {
        let mp4 = std::fs::read(s.render("turn.mp4", &["--view", "orbit:3", "--size", "64x48"])).unwrap();
        assert_eq!(&mp4[4..8], b"ftyp");
    }
}

#[test]
fn what_a_change_does_not_touch_stays_the_photos() {
    let s = scanned();
    let photo = s.photo();
    let over = ["--view", "keyframe:0", "--over", "photo"];
    let with = |name: &str, more: &[&str]| png(&s.render(name, &[&over, more].concat())).1;
    assert_eq!(with("nothing.png", &[]), photo, "no change, the photo itself");

    let cube = with("cube.png", &["--insert", &s.path("box.ply")]);
    let touched = changed(&cube, &photo);
    let middle = (SIZE.1 / 2 * SIZE.0 + SIZE.0 / 2) as usize;
    assert!(touched.iter().any(|&i| i.abs_diff(middle) < 2 * SIZE.0 as usize), "it stands in the middle of the view");
    assert!(touched.len() > 40 && touched.len() < photo.len() / 3 / 2, "{}", touched.len());
    // Where its position is given, it stands there too.
    let placed = with("placed.png", &["--insert", &format!("{}@{},30,1", s.path("box.ply"), s.middle())]);
    let both = changed(&placed, &photo).into_iter().filter(|i| touched.contains(i)).count();
    assert!(2 * both > touched.len(), "{both} of {}", touched.len());
}

#[test]
fn a_removed_thing_is_gone_with_what_it_hid_filled() {
    let s = scanned();
    let photo = s.photo();
    // Looked at from keyframe 0, the larger ball is left of the middle: find a pixel that shows it by its red.
    let red = (0..photo.len() / 3)
        .max_by_key(|i| i32::from(photo[3 * i]) - i32::from(photo[3 * i + 1]).max(i32::from(photo[3 * i + 2])))
        .unwrap();
    let (x, y) = (red % SIZE.0 as usize, red / SIZE.0 as usize);
    let over = ["--view", "keyframe:0", "--over", "photo"];
    let picture = png(&s.render("gone.png", &[&over[..], &["--remove", &format!("point:{x},{y}")]].concat())).1;
    let redness = |p: &[u8]| i32::from(p[0]) - i32::from(p[1]).max(i32::from(p[2]));
    assert!(redness(&photo[3 * red..]) > 40, "{}", redness(&photo[3 * red..]));
    assert!(redness(&picture[3 * red..]) < 20, "{}", redness(&picture[3 * red..]));
    assert!(!changed(&picture, &photo).is_empty());

    // The same by its segment.
    let scene = estimator::rays::RayScene::new(&s.estimate.mesh);
    let k = &s.estimate.keyframes[0];
    let d = k.world_from_camera.rotation * k.camera.unproject(x as f64, y as f64);
    let (eye, d) = (k.world_from_camera.translation.as_vec3(), d.normalize().as_vec3());
    let hit = scene.closest_hit(eye, d).expect("the ball");
    let vertex = s.estimate.mesh.triangles[hit.triangle as usize][0] as usize;
    let segment = format!("segment:{}", s.estimate.segment[vertex]);
    let again = png(&s.render("segment.png", &[&over[..], &["--remove", &segment]].concat())).1;
    assert!(redness(&again[3 * red..]) < 20);

    // And by a box around it, with a cube in its place, and another on the table.
    let p = s.estimate.mesh.positions[vertex];
    let (low, high) = (p - 0.13, p + 0.13);
    let around = format!("box:{},{},{},{},{},{}", low.x, low.y, low.z, high.x, high.y, high.z);
    let cube = s.path("box.ply");
    let (first, second) = (format!("{cube}@{},{},{}", p.x, p.y, p.z), format!("{cube}@{},0,2", s.middle()));
    let changes = ["--remove", &around, "--insert", &first, "--insert", &second];
    let all = png(&s.render("all-changes.png", &[&over[..], &changes].concat())).1;
    assert!(changed(&all, &photo).len() > changed(&picture, &photo).len() / 2);
}

#[test]
fn things_of_other_forms_and_other_scans_are_inserted() {
    let s = scanned();
    let (glb, result) = (s.path("own.glb"), s.path("result.lres"));
    ok(&["export", &result, "--to", "glb", "-o", &glb]);
    let view = ["--view", "keyframe:0"];
    let without = png(&s.render("without.png", &view)).1;
    let place = format!("@{},90,0.3", s.middle());
    // A segment is a piece of a scan: as large as it is, it is to be seen.
    let as_it_is = format!("@{},90", s.middle());
    let small = (0..s.estimate.segments.len()).filter(|i| s.estimate.segments[*i].vertices > 50);
    let smallest = small.min_by_key(|i| s.estimate.segments[*i].vertices).unwrap();
    for (name, object, place) in [
        ("glb.png", glb, &place),
        ("whole.png", result.clone(), &place),
        ("part.png", format!("{result}#segment={smallest}"), &as_it_is),
        ("cube.png", s.path("box.ply"), &place),
    ] {
        let picture = png(&s.render(name, &[&view[..], &["--insert", &format!("{object}{place}")]].concat())).1;
        assert!(!changed(&picture, &without).is_empty(), "{name}");
    }
    let look = |name: &str, material: &[&str]| {
        let insert = format!("{}@{},0,3", s.path("box.ply"), s.middle());
        png(&s.render(name, &[&view[..], &["--insert", &insert], material].concat())).1
    };
    assert_ne!(look("white.png", &[]), look("material.png", &["--material", "segment:0"]));
}

#[test]
fn every_kind_of_light() {
    let s = scanned();
    let lights = s.dir.join("lights");
    std::fs::create_dir(&lights).unwrap();
    panorama(&lights.join("0.png"), 64, 32);
    panorama(&lights.join("1.png"), 32, 16);
    for form in ["hdr", "exr"] {
        ok(&["export", &s.path("result.lres"), "--to", form, "-o", &s.path(&format!("light.{form}"))]);
    }
    ok(&["export", &s.path("result.lres"), "--to", "folder", "-o", &s.path("folder")]);
    let view = ["--view", "keyframe:0", "--size", "80x60"];
    let lit = |name: &str, more: &[&str]| png(&s.render(name, &[&view, more].concat())).1;
    let first = lit("png.png", &["--light", &arg(lights.join("0.png"))]);
    let turned = lit("turned.png", &["--light", &arg(lights.join("0.png")), "--light-yaw", "120"]);
    assert!(changed(&first, &turned).len() > 500);
    assert_eq!(first, lit("round.png", &["--light", &arg(lights.join("0.png")), "--light-yaw", "0"]));

    // The scan's own light as two panoramas and as two lists of coefficients.
    let own: Vec<Vec<u8>> = [
        ("a.png", s.path("light.hdr")),
        ("b.png", s.path("light.exr")),
        ("c.png", format!("result:{}", s.path("result.lres"))),
        ("d.png", format!("sh:{}", s.path("folder/lighting_sh.json"))),
    ]
    .iter()
    .map(|(name, light)| lit(name, &["--light", light]))
    .collect();
    let difference =
        |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64;
    let (panoramas, coefficients) = (difference(&own[0], &own[1]), difference(&own[2], &own[3]));
    assert!(panoramas < 1.5 && coefficients < 0.5, "{panoramas} {coefficients}");

    // The pictures of the scan show more of the light than the result alone.
    std::fs::create_dir(s.dir.join("alone")).unwrap();
    std::fs::copy(s.dir.join("result.lres"), s.dir.join("alone/result.lres")).unwrap();
    let own_scan = ["--scan", &s.path("scan.lscan")];
    for (name, scan) in [("alone.hdr", &[][..]), ("given.hdr", &own_scan)] {
        ok(&[&["export", &s.path("alone/result.lres"), "--to", "hdr", "-o", &s.path(name)], scan].concat());
    }
    let light = |name: &str| std::fs::read(s.dir.join(name)).unwrap();
    assert!(light("light.hdr") == light("given.hdr") && light("light.hdr") != light("alone.hdr"));

    let frames = s.render("frames", &[&view[..], &["--light", &arg(&lights)]].concat());
    assert_eq!(names(&frames), ["000.png", "001.png"]);
    assert_eq!(
        names(&s.render("views", &["--view", "all", "--size", "40x30", "--light", &s.path("light.hdr")])).len(),
        s.estimate.keyframes.len()
    );

    // Over the photo, with something inserted and something removed, in another light.
    let cube = format!("{}@{}", s.path("box.ply"), s.middle());
    let all = ["--view", "keyframe:0", "--over", "photo", "--insert", &cube, "--remove", "segment:0", "--light"];
    let picture = png(&s.render("all-lit.png", &[&all[..], &[&s.path("light.hdr")]].concat())).1;
    assert_eq!(picture.len(), s.photo().len());

    if has_ffmpeg() {
        let video = s.path("lights.mp4");
        let made = std::process::Command::new("ffmpeg")
            .args(["-v", "error", "-loop", "1", "-i", &arg(lights.join("0.png")), "-frames:v", "3", &video])
            .status()
            .unwrap();
        assert!(made.success());
        let frames = s.render("video", &[&view[..], &["--light", &video]].concat());
        assert_eq!(names(&frames), ["000.png", "001.png", "002.png"]);
    }
}

#[test]
fn the_same_command_gives_the_same_bytes() {
    let s = scanned();
    let cube = s.path("box.ply");
    let command = ["--view", "keyframe:0", "--over", "photo", "--insert", &cube, "--threads"];
    let runs = ["1", "2", "3"]
        .map(|n| std::fs::read(s.render(&format!("run{n}.png"), &[&command[..], &[n]].concat())).unwrap());
    assert!(runs[0] == runs[1] && runs[1] == runs[2]);
}

#[test]
fn objects_that_cannot_be_used_are_3() {
    let s = scanned();
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(s.dir.join(name), bytes).unwrap();
        s.path(name)
    };
    let glb = s.path("whole.glb");
    ok(&["export", &s.path("result.lres"), "--to", "glb", "-o", &glb]);
    let whole = std::fs::read(&glb).unwrap();
    let cube = box_ply(0.05);
    let gltf = r#"{"asset":{"version":"2.0"},"buffers":[{"uri":"nowhere.bin","byteLength":12}]}"#;
    for (file, says) in [
        (write("cut.glb", &whole[..whole.len() / 2]), "truncated"),
        (write("empty.glb", b""), "empty"),
        (write("cut.ply", &cube.as_bytes()[..cube.len() - 20]), ""),
        (write("nan.ply", cube.replacen("\n0.025", "\nnan", 1).as_bytes()), ""),
        (write("none.ply", cube.replace("element face 12", "element face 0").as_bytes()), "triangle"),
        (write("refers.gltf", gltf.as_bytes()), "nowhere.bin"),
        (s.path("absent.glb"), "absent.glb"),
        (format!("{}#segment=99999", s.path("result.lres")), "99999"),
    ] {
        let message = s.refuses(3, &["--insert", &file]);
        assert!(message.contains(says) && message.contains(file.split('#').next().unwrap()), "{file}: {message}");
    }
    assert!(s.refuses(2, &["--insert", "x.glb@1,2"]).contains("x,y,z"));
    assert!(s.refuses(2, &["--insert", &s.path("box.ply"), "--material", "segment:99999"]).contains("99999"));
}

#[test]
fn odd_places_are_said_and_still_rendered() {
    let s = scanned();
    let say = |name: &str, place: &str| {
        let insert = format!("{}@{place}", s.path("box.ply"));
        let out =
            run(&[&["render", &s.path("result.lres"), "-o", &s.path(name), "--insert", &insert], &QUICK[..]].concat());
        assert!(out.status.success() && s.dir.join(name).exists(), "{}", text(&out.stderr));
        text(&out.stderr)
    };
    assert!(say("far.png", "50,0,0").contains("outside the scan"));
    let p = s.middle();
    let mut under: Vec<f32> = p.split(',').map(|x| x.parse().unwrap()).collect();
    under[2] -= 0.1;
    assert!(say("under.png", &format!("{},{},{}", under[0], under[1], under[2])).contains("under"));
    let plain = say("plain.png", &p);
    assert!(!plain.contains("outside") && !plain.contains("under a"), "{plain}");
}

#[test]
fn requests_that_make_no_sense_are_2() {
    let s = scanned();
    assert!(s.refuses(2, &["--view", "keyframe:9999"]).contains("9999"));
    assert!(s.refuses(2, &["--view", "all"]).contains("folder"));
    assert!(s.refuses(2, &["--view", "orbit:2", "--over", "photo"]).contains("folder"));
    assert!(s.refuses(2, &["--over", "photo", "--size", "80x60"]).contains("own size"));
    assert!(s.refuses(2, &["--remove", "segment:9999"]).contains("9999"));
    assert!(s.refuses(2, &["--remove", "box:-99,-99,-99,99,99,99"]).contains("everything"));
    assert!(s.refuses(2, &["--remove", "box:50,50,50,51,51,51"]).contains("no part"));
    assert!(s.refuses(2, &["--exposure", "0"]).contains("more than 0"));
    let away = serde_json::json!({ "camera_angle_x": 0.5, "frames": [{ "transform_matrix":
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 900.0], [0.0, 0.0, 0.0, 1.0]] }] });
    std::fs::write(s.dir.join("away.json"), away.to_string().replace("900.0", "-900.0")).unwrap();
    assert!(s.refuses(2, &["--view", &s.path("away.json")]).contains("looks away"));
    let alone = s.dir.join("alone");
    std::fs::create_dir_all(&alone).unwrap();
    std::fs::copy(s.dir.join("result.lres"), alone.join("result.lres")).unwrap();
    let out = arg(alone.join("out.png"));
    let message = fails(2, &["render", &arg(alone.join("result.lres")), "-o", &out, "--over", "photo"]);
    assert!(message.contains("--scan"), "{message}");
    assert_eq!(names(&alone), ["result.lres"]);
    // What exists is not overwritten by a folder.
    assert!(fails(2, &["render", &s.path("result.lres"), "-o", &arg(&s.dir), "--view", "all"]).contains("empty"));
}

#[test]
fn lights_that_cannot_be_used_are_3() {
    let s = scanned();
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(s.dir.join(name), bytes).unwrap();
        s.path(name)
    };
    panorama(&s.dir.join("square.png"), 32, 32);
    let negative = hdr_like_exr(-1.0);
    let nan = hdr_like_exr(f32::NAN);
    for (light, says) in [
        (s.path("square.png"), "twice as wide"),
        (write("wide.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16384 +X 32768\n"), "32768"),
        (write("negative.exr", &negative), "negative"),
        (write("nan.exr", &nan), "NaN"),
        (write("empty.hdr", b""), "empty"),
        (format!("sh:{}", write("sh.json", b"{\"coefficients\": [[1, 2, 3], [1, 2, 3]]}")), "square number"),
        (format!("result:{}", write("old.lres", b"LRES")), "old.lres"),
        (s.path("absent.hdr"), "absent.hdr"),
    ] {
        let message = s.refuses(3, &["--light", &light]);
        assert!(message.contains(says), "{light}: {message}");
    }
    let nothing = s.dir.join("no-panoramas");
    std::fs::create_dir_all(&nothing).unwrap();
    assert!(s.refuses(3, &["--light", &arg(&nothing)]).contains("no panoramas"));
    if has_ffmpeg() {
        let out = s.path("no-video");
        let light = write("empty.mp4", b"no video at all");
        let message = fails(3, &["render", &s.path("result.lres"), "-o", &out, "--light", &light]);
        assert!(message.contains("without frames") && !Path::new(&out).exists(), "{message}");
    }
}

/// A 4 × 2 OpenEXR picture of one value.
fn hdr_like_exr(value: f32) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("p.exr");
    estimator::export::picture::write_exr(&path, 4, 2, &[glam::Vec3::splat(value); 8]).unwrap();
    std::fs::read(path).unwrap()
}

//! What the unit tests share.

use crate::codec::image::encode_depth_png;
use crate::decision::{
    BandsGain, BouncedLight, Cut, Decision, DecisionText, ExposureModel, LightRung, PositionEvidence, Reduction,
    ResponseTest, ScaleBasis, TransferLevel, TransferNext, Warning,
};
use crate::local_light::{Emitter, Lamp, LightModel, LocalLight};
use crate::recording::Event;
use crate::result::{Chart, Estimate, Light, ResultKeyframe, Segment, Texture, WitnessError};
use crate::scan::{CaptureStats, Scan, ScanSource};
use crate::types::{
    Accelerometer, CameraModel, ColorEncoding, ColorFrame, DepthFrame, Distortion, Intrinsics, Keyframe, Mesh, Pose,
    Response, Sensor, UsbPacket,
};
use glam::{DQuat, DVec3, Vec3};

/// A 32x24 JPEG: (8x, 10y, 128 + 40 sin(x/3)), quality 90.
pub(crate) const GRADIENT_JPEG: &[u8] = include_bytes!("../data/samples/gradient.jpg");

pub(crate) fn color_frame(ns: i64, width: u32, height: u32, encoding: ColorEncoding, bytes: Vec<u8>) -> ColorFrame {
    ColorFrame { timestamp_ns: ns, width, height, encoding, bytes, missing_packets: 0 }
}

/// A TUM folder of 32x24 frames: colour every 33 ms, depth every 43 ms, depth value 1000 + pixel index.
pub(crate) fn tum_folder(frames: usize) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let (mut rgb, mut depth) = (String::from("# colour\n"), String::from("# depth\n"));
    for sub in ["rgb", "depth"] {
        std::fs::create_dir(dir.path().join(sub)).unwrap();
    }
    for i in 0..frames {
        rgb += &format!("0.{:06} rgb/{i}.jpg\n", i * 33_000);
        depth += &format!("0.{:06} depth/{i}.png\n", i * 43_000);
        std::fs::write(dir.path().join(format!("rgb/{i}.jpg")), GRADIENT_JPEG).unwrap();
        let values: Vec<u16> = (0..32 * 24).map(|p| 1000 + p + i as u16).collect();
        let png = encode_depth_png(32, 24, &values).unwrap();
        std::fs::write(dir.path().join(format!("depth/{i}.png")), png).unwrap();
    }
    std::fs::write(dir.path().join("rgb.txt"), rgb).unwrap();
    std::fs::write(dir.path().join("depth.txt"), depth).unwrap();
    let camera = "# a small camera\n30 30 15.5 11.5 5000 32 24\n# k1 k2 p1 p2 k3 = 0.1 -0.01 0.001 0.002 0.003\n";
    std::fs::write(dir.path().join("camera.txt"), camera).unwrap();
    dir
}

pub(crate) fn camera(width: u32, height: u32) -> CameraModel {
    let intrinsics = Intrinsics { width, height, fx: 30.0, fy: 30.5, cx: 15.5, cy: 11.5 };
    CameraModel { intrinsics, distortion: Distortion { k1: 0.1, ..Distortion::NONE } }
}

/// A sensor with 32x24 colour and 16x12 depth.
pub(crate) fn sensor() -> Sensor {
    Sensor {
        name: "made up".into(),
        serial: "42".into(),
        color: camera(32, 24),
        depth: camera(16, 12).undistorted(),
        color_from_depth: Pose::new(DQuat::from_xyzw(0.01, 0.02, 0.03, 1.0), DVec3::new(0.025, 0.0, 0.001)),
        depth_registered: false,
        depth_unit_m: 0.001,
        response: Response::Gamma(2.2),
        depth_to_color_offset_ns: -20_000_000,
    }
}

/// A bumpy square of `n` × `n` vertices.
pub(crate) fn bumpy_mesh(n: u32) -> Mesh {
    let at = |x: u32, y: u32| y * n + x;
    let cells = (0..n - 1).flat_map(|y| (0..n - 1).map(move |x| (x, y)));
    let position = |i: u32| {
        let (x, y) = ((i % n) as f32 / n as f32, (i / n) as f32 / n as f32);
        Vec3::new(x, y, 0.1 * libm::sinf(9.0 * x) * libm::cosf(7.0 * y))
    };
    Mesh {
        positions: (0..n * n).map(position).collect(),
        normals: (0..n * n).map(|i| Vec3::new((i % 7) as f32 - 3.0, (i % 5) as f32 - 2.0, 4.0).normalize()).collect(),
        triangles: cells
            .flat_map(|(x, y)| [[at(x, y), at(x + 1, y), at(x, y + 1)], [at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]])
            .collect(),
    }
}

pub(crate) fn keyframe(ns: i64) -> Keyframe {
    Keyframe {
        name: crate::format_seconds(ns),
        world_from_camera: sensor().color_from_depth,
        camera: sensor().color,
        color: color_frame(ns, 32, 24, ColorEncoding::Jpeg, GRADIENT_JPEG.to_vec()),
    }
}

pub(crate) fn scan() -> Scan {
    Scan {
        name: "a scan".into(),
        source: ScanSource::Fusion,
        sensor: sensor(),
        mesh: bumpy_mesh(5),
        keyframes: vec![keyframe(1_000_000_000), keyframe(2_500_000_000)],
        witnesses: vec![keyframe(1_700_000_000)],
        config: "[fusion]\n".into(),
        stats: CaptureStats { pairs: 9, duration_s: 1.5, ..CaptureStats::default() },
    }
}

/// Decisions of every kind.
pub(crate) fn decisions() -> Vec<Decision> {
    let no = String::new;
    let old = DecisionText { name: "old".into(), choice: no(), evidence: no(), cost: no(), next_level: no() };
    let response =
        |stated, values, test| Decision::Response { stated, values, min_exposure_ratio: 1.5, min_shared: 200, test };
    let test = ResponseTest { alternative: Response::Gamma(2.2), stated_change: 0.012, alternative_change: 0.234 };
    let specular = |cleaned, glossy, exposure_change, without_gloss, with_gloss| Decision::Specular {
        cleaned,
        segments: 7,
        glossy,
        exposure_change,
        without_gloss,
        with_gloss,
    };
    let transfer = |chosen, rays, blocked, relative_error, bounced, next| Decision::Transfer {
        chosen,
        vertices: 10_000,
        rays,
        blocked,
        relative_error,
        bounced,
        next,
    };
    let scale = |chosen| Decision::AlbedoScale {
        chosen,
        irradiance_color: [1.04, 1.0, 0.96],
        albedo_color: [1.3, 1.0, 0.77],
        near_white: 0.12,
        quantile: 0.98,
        brightest: 0.8,
        vertices: 9000,
    };
    let bounced = BouncedLight { bounces: 8, share: 0.1, last_share: 5e-4 };
    vec![
        Decision::Text(old),
        response(Response::Srgb, 900, Some(test)),
        response(Response::Gamma(2.2), 0, None),
        Decision::Exposure { chosen: ExposureModel::Scalar, none: 0.5, scalar: 0.25, rgb: 0.24, patches: 70 },
        Decision::Pose { refined: true, steps_px: vec![0.52, 0.13], first_residual: 0.031, last_residual: 0.022 },
        Decision::Bands {
            chosen: 3,
            held_out: vec![(3, 0.01), (5, 0.0099)],
            condition: 120.0,
            next: Some(BandsGain { bands: 5, gain: 1e-4, standard_error: 2e-4 }),
        },
        Decision::RaysWithoutGloss {
            chosen: 256,
            before: 128,
            held_out: 0.05,
            error_before: 0.02,
            error: 0.014,
            vertices: 10_000,
        },
        specular(false, 0, None, None, vec![]),
        specular(false, 2, None, Some(0.1), vec![0.12]),
        specular(true, 2, Some(0.004), Some(0.1), vec![0.09, 0.095]),
        Decision::BandsWithoutGloss {
            chosen: 5,
            first: 3,
            before: 3,
            tried: 5,
            error_before: 0.09,
            errors: vec![0.08, 0.081],
        },
        Decision::DistantLight {
            holds: false,
            position: PositionEvidence { explained: 0.3, change: 0.09 },
            vertices: 5000,
        },
        Decision::Witnesses {
            frames: 4,
            refined: true,
            lit_psnr_db: 30.0,
            model_psnr_db: 28.0,
            moved_px: 1.5,
            tracked_lit_psnr_db: 25.0,
            tracked_model_psnr_db: 24.0,
            own_psnr_db: 35.0,
        },
        transfer(TransferLevel::Diffuse, 0, 0.005, 0.0, None, TransferNext::Visibility),
        transfer(TransferLevel::Gi, 128, 0.2, 0.02, Some(bounced), TransferNext::TwiceRays { relative_error: 0.014 }),
        Decision::LightModel {
            chosen: LightModel::Lamps,
            ladder: vec![
                LightRung { model: LightModel::Distant, held_out: 0.4 },
                LightRung { model: LightModel::Lamps, held_out: 0.05 },
            ],
            samples: 5000,
        },
        scale(ScaleBasis::Likely),
        scale(ScaleBasis::SecondaryLight),
        scale(ScaleBasis::Reference { albedo: [0.9, 0.9, 0.8] }),
    ]
}

/// Cuts of every kind.
pub(crate) fn cuts() -> Vec<Cut> {
    let reductions = [
        Reduction::Bounces { to: 2, from: None },
        Reduction::Rays { to: 32, from: 128 },
        Reduction::PoseRounds { to: 0, from: 4 },
        Reduction::Specular,
        Reduction::Bands { to: 5, from: 9 },
        Reduction::Keyframes { stride: 2, of: 30 },
        Reduction::Vertices { to: 7000, from: 10_000 },
    ];
    let others = [
        Cut::Text("old".into()),
        Cut::FewerRays { rays: 32, instead_of: 128 },
        Cut::LateRays { rays: 16, instead_of: 64 },
        Cut::Specular,
        Cut::Witnesses { predicted: 1, of: 2 },
        Cut::AbandonedTransfer { rays: 8 },
    ];
    reductions.map(|what| Cut::Planned { what, speed: 0.5 }).into_iter().chain(others).collect()
}

/// Warnings of every kind.
pub(crate) fn warnings() -> Vec<Warning> {
    vec![
        Warning::Text("old".into()),
        Warning::ResponseMismatch { stated: Response::Srgb, better: Response::Gamma(2.2) },
        Warning::LightNotDistant(PositionEvidence { explained: 0.3, change: 0.09 }),
        Warning::OneKeyframe,
        Warning::UnseenLight { directions: 2 },
    ]
}

/// A result on a mesh, with two segments and noisy colours.
pub(crate) fn estimate_on(mesh: Mesh) -> Estimate {
    let n = mesh.positions.len() as u32;
    let noise = |i: u32| (i.wrapping_mul(2_654_435_761) >> 8) as f32 / (1u32 << 24) as f32;
    let color = |i: u32| Vec3::new(0.4, 0.3, 0.2) * (0.7 + 0.05 * noise(i)) + 0.01 * noise(i ^ 0x5555);
    let segment = |i: u32| u32::from(mesh.positions[i as usize].x > 0.5);
    let row = |k: u32| [f64::from(k) * 0.1, 0.2, -0.3];
    let segment_of = |vertices| Segment { vertices, albedo: [0.5; 3], w_d: 1.0, w_s: 0.1, w_s_error: f64::INFINITY };
    Estimate {
        name: "a result".into(),
        response: Response::Srgb,
        segment: (0..n).map(segment).collect(),
        lit_color: (0..n).map(color).collect(),
        albedo: (0..n).map(|i| color(i) * 1.5).collect(),
        confidence: (0..n).map(noise).collect(),
        light: Light {
            coefficients: (0..9).map(row).collect(),
            standard_deviation: vec![[0.01, 0.02, f64::INFINITY]; 9],
            directions: vec![[0.0, 0.0, 1.0]],
            radiance: vec![[1.0, 2.0, 3.0]],
        },
        segments: vec![segment_of(1), segment_of(2)],
        keyframes: vec![ResultKeyframe {
            name: "keyframes/000.png".into(),
            timestamp_ns: 5,
            gain: [1.0, 1.1, 0.9],
            world_from_camera: sensor().color_from_depth,
            camera: sensor().color,
            residual_px: 0.25,
        }],
        transfer: TransferLevel::Gi,
        decisions: decisions(),
        cuts: cuts(),
        warnings: warnings(),
        albedo_scale_rule: "mean 0.5".into(),
        witnesses: vec![WitnessError { name: "w".into(), lit_psnr_db: 30.0, model_psnr_db: 28.0, coverage: 0.8 }],
        local_light: LocalLight {
            model: LightModel::LampsAndEmitters,
            lamps: vec![Lamp { center: [0.1, 0.2, 1.5], radius_m: 0.05, radiance: [9.0, 8.0, 7.0] }],
            emitters: vec![Emitter { vertices: (0..n.min(2)).collect(), radiance: [5.0, 4.0, 3.0] }],
        },
        texture: None,
        mesh,
    }
}

/// Every truncation (in steps) and many bit flips of a file must be refused by `read`, without panic.
pub(crate) fn refuses_damage<T>(path: &std::path::Path, read: impl Fn(&std::path::Path) -> crate::Result<T>) {
    let whole = std::fs::read(path).unwrap();
    let damaged = path.with_extension("damaged");
    for length in (0..whole.len()).step_by(1 + whole.len() / 200) {
        std::fs::write(&damaged, &whole[..length]).unwrap();
        let message = read(&damaged).err().unwrap_or_else(|| panic!("{length} bytes were accepted")).to_string();
        assert!(message.contains("damaged"), "the file is not named: {message}");
    }
    for at in (0..whole.len()).step_by(1 + whole.len() / 200) {
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (at % 8);
        std::fs::write(&damaged, &bytes).unwrap();
        assert!(read(&damaged).is_err(), "a flip in byte {at} was not noticed");
    }
}

/// `n` times an accelerometer reading, colour (JPEG, or Bayer for every second) and depth of [`sensor`], 30 ms apart.
pub(crate) fn events(n: u32) -> Vec<Event> {
    let one = |i: u32| {
        let ns = i64::from(i) * 30_000_000;
        let bytes = if i.is_multiple_of(2) {
            GRADIENT_JPEG.to_vec()
        } else {
            (0..32 * 24).map(|p| (p * 7 % 256) as u8).collect()
        };
        let encoding = if i.is_multiple_of(2) { ColorEncoding::Jpeg } else { ColorEncoding::BayerGrbg };
        let missing_packets = if i == 1 { 7 } else { 0 };
        let depth = (0..16 * 12u32).map(|p| if p % 13 == 0 { 0 } else { (700 + i * 3 + p / 16 * 5) as u16 });
        [
            Event::Accelerometer(Accelerometer { timestamp_ns: ns, acceleration: [0.1, -9.81, i as f32] }),
            Event::Color(ColorFrame { missing_packets, ..color_frame(ns + 10_000_000, 32, 24, encoding, bytes) }),
            Event::Depth(DepthFrame {
                timestamp_ns: ns + 20_000_000,
                width: 16,
                height: 12,
                depth: depth.collect(),
                missing_packets: i.saturating_sub(1),
            }),
        ]
    };
    (0..n).flat_map(one).collect()
}

/// `n` packets of 700 bytes, the second replaced by an accelerometer reading.
pub(crate) fn packets(n: u32) -> Vec<Event> {
    let one = |i: u32| match i {
        1 => Event::Accelerometer(Accelerometer { timestamp_ns: 5, acceleration: [0.0, 0.0, 9.81] }),
        _ => Event::Packet(UsbPacket {
            timestamp_ns: i64::from(i) * 125_000,
            endpoint: if i.is_multiple_of(2) { 0x81 } else { 0x82 },
            data: (0..700).map(|b| (b * i % 256) as u8).collect(),
        }),
    };
    (0..n).map(one).collect()
}

/// The file with one payload byte changed and its chunk's checksum made right again: what a reader must survive though
/// the container finds nothing wrong.
pub(crate) fn resealed(whole: &[u8], at: usize, value: u8) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    let mut begin = 16;
    while begin + 12 <= whole.len() {
        let length = u32::from_le_bytes([4, 5, 6, 7].map(|k| whole[begin + k])) as usize;
        let payload = begin + 12..begin + 12 + length;
        if payload.contains(&at) {
            bytes[at] = value;
            let mut hasher = crc32fast::Hasher::new();
            hasher.update(&bytes[begin..begin + 8]);
            hasher.update(&bytes[payload.clone()]);
            bytes[begin + 8..begin + 12].copy_from_slice(&hasher.finalize().to_le_bytes());
        }
        begin = payload.end;
    }
    bytes
}

/// A file that holds `text`; it goes with the folder.
pub fn text_file(text: &str) -> (tempfile::TempDir, std::path::PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("file.txt");
    std::fs::write(&path, text).unwrap();
    (dir, path)
}

/// The result with a small texture in two charts.
pub(crate) fn textured(mut estimate: Estimate) -> Estimate {
    let (width, height) = (24, 16);
    let pixels: Vec<u8> = (0..3 * width * height).map(|i| (i % 251) as u8).collect();
    let mut jpeg = Vec::new();
    jpeg_encoder::Encoder::new(&mut jpeg, 90).encode(&pixels, width, height, jpeg_encoder::ColorType::Rgb).unwrap();
    let chart = |x_offset| Chart { x_axis: [8.0, 0.0, 0.0], y_axis: [0.0, 8.0, 0.0], x_offset, y_offset: 2.0 };
    let triangles = 0..estimate.mesh.triangles.len() as u32;
    estimate.texture = Some(Texture {
        width: width.into(),
        height: height.into(),
        texel_m: 0.125,
        scale: 1.0,
        charts: vec![chart(2.0), chart(12.0)],
        chart: triangles.map(|t| t % 3 / 2).collect(),
        jpeg,
    });
    estimate
}

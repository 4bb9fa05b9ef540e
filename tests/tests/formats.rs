//! Real recordings and the truth scenes through readers and coders.

#![allow(clippy::unwrap_used, reason = "these are tests")]

use recordings::import::photos::import_photos;
use recordings::import::tum::{TumReader, export_tum, import_tum};
use recordings::recording::{Event, RecordingKind, RecordingReader, RecordingWriter};
use recordings::types::{ColorEncoding, ColorFrame};
use tests::shared;
use tests::truth::json;
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;
use zune_jpeg::JpegDecoder;

const RECORDINGS: [(&str, usize); 3] = [("scenenn_31", 31), ("tum_fr1_xyz_400", 400), ("redkitchen_300", 300)];

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the recordings of data/")]
fn tum_folders_are_read_and_their_depth_takes_less_than_a_twelfth() {
    let shared = shared();
    let dir = tempfile::tempdir().unwrap();
    for (name, frames) in RECORDINGS {
        let reader = TumReader::open(&shared.join("data").join(name)).unwrap();
        assert_eq!(reader.events(), 2 * frames);
        let mut depth_frames = 0;
        for index in (0..8).chain([frames, 2 * frames - 1]) {
            match reader.event(index).unwrap().unwrap() {
                Event::Color(color) => assert_eq!(color.decode().unwrap().width, 640),
                Event::Depth(depth) => {
                    assert!(depth.depth.iter().filter(|d| **d > 0).count() > 50_000);
                    let (raw, path) = (2 * depth.depth.len() as u64, dir.path().join("depth.lrec"));
                    let mut writer = RecordingWriter::create(&path, RecordingKind::Frames, reader.sensor()).unwrap();
                    writer.write(&Event::Depth(depth)).unwrap();
                    writer.finish().unwrap();
                    let bytes = path.metadata().unwrap().len();
                    assert!(bytes < raw / 12, "{name}, event {index}: {bytes} bytes");
                    depth_frames += 1;
                }
                _ => panic!("neither depth nor colour"),
            }
        }
        assert!(depth_frames >= 3, "{name}: {depth_frames} depth frames");
    }
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: data/scenenn_31")]
fn folder_to_recording_to_folder_is_exact() {
    let folder = shared().join("data/scenenn_31");
    let dir = tempfile::tempdir().unwrap();
    let [recording, again, back] = ["a.lrec", "b.lrec", "back"].map(|name| dir.path().join(name));
    import_tum(&folder, &recording).unwrap();
    export_tum(&mut RecordingReader::open(&recording).unwrap(), &back).unwrap();
    let (mut original, mut copy) = (TumReader::open(&folder).unwrap(), TumReader::open(&back).unwrap());
    assert_eq!((original.sensor(), original.events()), (copy.sensor(), copy.events()));
    while let Some(event) = original.next_event().unwrap() {
        assert!(copy.next_event().unwrap() == Some(event));
    }
    import_tum(&back, &again).unwrap();
    assert!(std::fs::read(&recording).unwrap() == std::fs::read(&again).unwrap());
}

/// The decoder's SIMD paths against its portable path.
#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: pictures of data/")]
fn jpeg_pixels_do_not_depend_on_the_instruction_set() {
    let shared = shared();
    for name in ["scenenn_31/rgb/frame_00000_rgb.jpg", "redkitchen_300/rgb/frame-000000.jpg"] {
        let bytes = std::fs::read(shared.join("data").join(name)).unwrap();
        let options = DecoderOptions::default().set_use_unsafe(false).jpeg_set_out_colorspace(ColorSpace::RGB);
        let portable = JpegDecoder::new_with_options(ZCursor::new(&bytes), options).decode().unwrap();
        let encoding = ColorEncoding::Jpeg;
        let frame = ColorFrame { timestamp_ns: 0, width: 640, height: 480, encoding, bytes, missing_packets: 0 };
        assert!(frame.decode().unwrap().data == portable, "{name}");
    }
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the scenes of truth/")]
fn both_descriptions_of_the_truth_scenes_agree() {
    let shared = shared();
    for (scene, vertices) in [("ball", 10_000), ("bunny", 34_000), ("fruits", 70_000)] {
        let dir = shared.join("truth").join(scene);
        let scan = import_photos(&dir, None).unwrap();
        assert!(scan.mesh.positions.len() > vertices);
        let description = json(&dir.join("keyframes.json"));
        let frames = description["frames"].as_array().unwrap();
        assert_eq!(frames.len(), scan.keyframes.len());
        for (frame, keyframe) in frames.iter().zip(&scan.keyframes) {
            assert_eq!(frame["file"], keyframe.name);
            for (r, row) in keyframe.world_from_camera.to_rows().iter().enumerate() {
                for (c, value) in row.iter().enumerate() {
                    let expected = frame["camera_to_world"][r][c].as_f64().unwrap();
                    assert!((value - expected).abs() < 1e-9, "{scene} {} {r} {c}", keyframe.name);
                }
            }
            let i = keyframe.camera.intrinsics;
            assert_eq!((i.fx, i.fy, i.cx, i.cy), (525.0, 525.0, 319.5, 239.5));
            let time_s = keyframe.color.timestamp_ns as f64 * 1e-9;
            assert!((frame["time_s"].as_f64().unwrap() - time_s).abs() < 1e-8);
        }
        assert!(scan.keyframes[0].color.decode().is_ok());
    }
}

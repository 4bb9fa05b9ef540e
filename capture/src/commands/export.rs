//! `lumiscan export`: results and recordings in forms that other programs read.

use crate::child_process::end_with_parent;
use crate::cli::{self, ExportTo};
use crate::commands::files::{check_fresh, find_scan, into_fresh_folder};
use crate::commands::output::check_parent;
use crate::commands::output::print;
use crate::device_folder::files::write_file;
use crate::failure::Failure;
use estimator::rays::RayScene;
use estimator::render::lighting::completion::completed;
use estimator::render::lighting::environment::Environment;
use recordings::import::tum::export_tum;
use recordings::recording::RecordingReader;
use recordings::result::Estimate;
use recordings::scan::Scan;
use std::path::Path;

/// Runs the command.
pub fn run(args: &cli::Export) -> Result<(), Failure> {
    end_with_parent(args.parent)?;
    let output = &args.output;
    let written = |e: std::io::Error| Failure::writing(output, e);
    match args.to {
        ExportTo::Tum => {
            let mut recording = RecordingReader::open(&args.file)?;
            check_fresh(output)?;
            export_tum(&mut recording, output)?;
        }
        ExportTo::Folder => {
            let result = Estimate::read(&args.file)?;
            into_fresh_folder(output, |dir| estimator::export::folder::write(&result, dir).map_err(written))?;
        }
        ExportTo::Ply => {
            check_parent(output)?;
            estimator::export::ply::write(&Estimate::read(&args.file)?, output).map_err(written)?;
        }
        ExportTo::Glb => {
            check_parent(output)?;
            let (result, light) = with_light(args)?;
            estimator::export::glb::scene::write(&result, &light, output).map_err(written)?;
        }
        ExportTo::Obj => {
            let result = Estimate::read(&args.file)?;
            into_fresh_folder(output, |dir| estimator::export::obj::write(&result, dir).map_err(written))?;
        }
        ExportTo::Exr => {
            check_parent(output)?;
            estimator::export::hdr::write_exr(&with_light(args)?.1, output).map_err(written)?;
        }
        ExportTo::Html => {
            check_parent(output)?;
            let result = Estimate::read(&args.file)?;
            let scan = scan(args)?;
            estimator::export::html::write(&result, scan.as_ref(), &timings(&args.file), output).map_err(written)?;
        }
        ExportTo::Preview => {
            check_parent(output)?;
            let (result, scan) = (Estimate::read(&args.file)?, scan_with_pictures(args)?);
            let png = estimator::preview::sheet::sheet(&scan, &result).map_err(|e| Failure::writing(output, e))?;
            write_file(output, &png)?;
        }
        ExportTo::Colmap | ExportTo::Nerf => {
            let (result, scan) = (Estimate::read(&args.file)?, scan_with_pictures(args)?);
            let write = match args.to {
                ExportTo::Colmap => estimator::export::cameras::write_colmap,
                _ => estimator::export::cameras::write_nerf,
            };
            into_fresh_folder(output, |dir| write(&result, &scan, dir).map_err(written))?;
        }
        ExportTo::Hdr => {
            check_parent(output)?;
            estimator::export::hdr::write(&with_light(args)?.1, output).map_err(written)?;
        }
    }
    print(&output.display().to_string())
}

/// A result and its distant light, with what the pictures of its scan show beyond the surface where there is one.
fn with_light(args: &cli::Export) -> Result<(Estimate, Environment), Failure> {
    let result = Estimate::read(&args.file)?;
    let light = completed(&result, scan(args)?.as_ref(), &RayScene::new(&result.mesh));
    Ok((result, light))
}

/// The scan of a result, if there is one.
fn scan(args: &cli::Export) -> Result<Option<Scan>, Failure> {
    Ok(find_scan(args.scan.as_deref(), &args.file).map(|p| Scan::read(&p)).transpose()?)
}

/// The scan of a result, for its pictures.
fn scan_with_pictures(args: &cli::Export) -> Result<Scan, Failure> {
    scan(args)?.ok_or_else(|| {
        Failure::Usage("the pictures are in the scan, which is not beside the result: --scan FILE".into())
    })
}

/// Seconds by stage from the manifest beside a published result; empty where there is none.
fn timings(result: &Path) -> Vec<(String, f64)> {
    let read = || -> Option<Vec<(String, f64)>> {
        let text = std::fs::read(result.with_file_name("manifest.json")).ok()?;
        let json: serde_json::Value = serde_json::from_slice(&text).ok()?;
        let seconds = |part: &str| serde_json::from_value::<Vec<(String, f64)>>(json[part]["seconds"].clone()).ok();
        Some([seconds("capture")?, seconds("estimator")?].concat())
    };
    read().unwrap_or_default()
}

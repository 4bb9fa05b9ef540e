//! What is fuzzed: each target takes bytes and must neither panic, nor take very long, nor allocate without bound.

mod files;
mod imports;
mod network;
mod pictures;
mod text;
mod usb;

const MIB: usize = 1 << 20;

/// Something that reads what comes from outside.
#[derive(Clone, Copy)]
pub struct Target {
    name: &'static str,
    /// Reads the bytes.
    pub run: fn(&[u8]),
    /// Bytes of the largest allocation that an input of a few KiB justifies; pictures and panoramas say their size themselves.
    pub most_bytes: usize,
}

const fn target(name: &'static str, run: fn(&[u8]), mib: usize) -> Target {
    Target { name, run, most_bytes: mib * MIB }
}

const ALL: [Target; 22] = [
    target("container", files::container, 4),
    target("scan", files::scan, 64),
    target("result", files::result, 64),
    target("recording", files::recording, 128),
    target("depth", files::depth, 4),
    target("packets", usb::packets, 4),
    target("control", usb::control, 4),
    target("lists", imports::lists, 4),
    target("trajectory", imports::trajectory, 4),
    target("transforms", imports::transforms, 4),
    target("npy", imports::npy, 4),
    target("ply", imports::ply, 4),
    target("gltf", pictures::gltf, 512),
    target("image", pictures::image, 512),
    target("panorama", pictures::panorama, 512),
    target("config", text::config, 4),
    target("setting", text::setting, 4),
    target("command_line", text::command_line, 4),
    target("plan", text::plan, 4),
    target("values", text::values, 4),
    target("http", network::http, 4),
    target("dns", network::dns, 4),
];

/// The target of this name.
pub fn find(name: &str) -> Option<Target> {
    ALL.into_iter().find(|t| t.name == name)
}

/// All names.
pub fn names() -> Vec<&'static str> {
    ALL.iter().map(|t| t.name).collect()
}

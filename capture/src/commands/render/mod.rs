//! `lumiscan render`. In: a result, its scan, objects, removals and lights. Out: pictures or a video of the changed scene.

pub mod command;
mod ffmpeg;
mod lights;
mod sink;

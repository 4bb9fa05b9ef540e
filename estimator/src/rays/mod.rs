//! Ray tracing. In: a triangle mesh. Out: [`RayScene`], which answers nearest-hit and occlusion queries through an
//! eight-wide BVH ([`wide_bvh`]) with a watertight triangle test ([`traversal`]).

pub mod ray_scene;
pub mod traversal;
pub mod wide_bvh;

pub use ray_scene::{Hit, RayScene};

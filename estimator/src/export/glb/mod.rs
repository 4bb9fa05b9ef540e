//! A result as a binary glTF 2.0 scene: mesh with albedo as vertex colours, a material per segment
//! (KHR_materials_specular), the light (EXT_lights_image_based, KHR_lights_punctual and emissive materials), the keyframes' cameras. +Y up: (x, y, z) = (X, Z, −Y).

mod buffer;
mod light;
mod local_light;
pub mod scene;

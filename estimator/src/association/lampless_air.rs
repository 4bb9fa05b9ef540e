//! Where pictures show that there is no lamp: air in front of what they see, where nothing is as bright as a lamp.

use crate::association::image_filters::dilated;
use crate::association::keyframe_image::KeyframeImage;
use crate::association::seen_lamps::is_free;
use crate::rays::RayScene;
use glam::{DVec3, Vec3};
use recordings::types::{Intrinsics, Pose};

/// Cells along the width of a picture.
const COLUMNS: usize = 160;
/// A lamp may be off by so many cells from where it is looked for: 3.5° in a Kinect's picture.
const REACH: usize = 10;
/// Keyframes that have to agree.
const LEAST_VIEWS: usize = 2;

/// What is dark in the pictures.
#[derive(Debug, Clone, Default)]
pub struct LamplessAir {
    views: Vec<View>,
}

/// One picture.
#[derive(Debug, Clone)]
struct View {
    camera_from_world: Pose,
    /// Position of the camera, world.
    center: DVec3,
    camera: Intrinsics,
    /// Pixels along a side of a cell.
    step: usize,
    /// Cells in a row, and rows.
    size: [usize; 2],
    /// Nothing in the cell and around it has a clipped channel: `[row][column]`.
    is_dark: Vec<bool>,
}

impl LamplessAir {
    /// Of these pictures and their poses. `clipped` is the first clipped 8-bit value.
    #[must_use]
    pub fn new(images: &[Option<KeyframeImage>], world_from_camera: &[Pose], clipped: u8) -> Self {
        let view = |(image, pose): (&Option<KeyframeImage>, &Pose)| Some(View::new(image.as_ref()?, pose, clipped));
        Self { views: images.iter().zip(world_from_camera).filter_map(view).collect() }
    }

    /// True if several keyframes look at a place through free air and see nothing bright there. A lamp that lights a scene is clipped.
    #[must_use]
    pub fn has_no_lamp(&self, scene: &RayScene, place: Vec3) -> bool {
        let place = place.as_dvec3();
        let dark = self.views.iter().filter(|view| view.is_dark_at(place) && is_free(scene, view.center, place, 0.0));
        dark.take(LEAST_VIEWS).count() == LEAST_VIEWS
    }
}

impl View {
    fn new(image: &KeyframeImage, world_from_camera: &Pose, clipped: u8) -> Self {
        let camera = image.camera;
        let step = (camera.width as usize / COLUMNS).max(1);
        let (width, height) = (camera.width as usize / step, camera.height as usize / step);
        let mut is_bright = vec![false; width * height];
        for y in 0..height * step {
            for x in 0..width * step {
                is_bright[y / step * width + x / step] |= image.bytes(x, y).iter().any(|b| *b >= clipped);
            }
        }
        let is_inner = |i: usize, size: usize| (REACH..size.saturating_sub(REACH)).contains(&i);
        let near_bright = dilated(&is_bright, width, height, REACH);
        let is_dark = |(i, bright): (usize, bool)| !bright && is_inner(i % width, width) && is_inner(i / width, height);
        Self {
            camera_from_world: world_from_camera.inverse(),
            center: world_from_camera.translation,
            camera,
            step,
            size: [width, height],
            is_dark: near_bright.into_iter().enumerate().map(is_dark).collect(),
        }
    }

    fn is_dark_at(&self, place: DVec3) -> bool {
        let p = self.camera_from_world.transform(place);
        let (u, v) = self.camera.project(p);
        let is_inside = p.z > 0.0 && u >= 0.0 && v >= 0.0;
        let ([x, y], [width, height]) = ([u, v].map(|pixel| pixel as usize / self.step), self.size);
        is_inside && x < width && y < height && self.is_dark[y * width + x]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::vignetting::Vignetting;
    use recordings::types::Mesh;

    /// A picture along +Z that is grey but for what lies `right` of a column.
    fn picture(right: u32) -> Option<KeyframeImage> {
        let camera = Intrinsics { width: 320, height: 240, fx: 250.0, fy: 250.0, cx: 159.5, cy: 119.5 };
        let pixel = |i: u32| if i % 320 >= right { [200, 255, 180] } else { [120; 3] };
        let data = (0..320 * 240).flat_map(pixel).collect();
        Some(KeyframeImage { camera, data, vignetting: Vignetting::default() })
    }

    #[test]
    fn air_that_is_seen_dark_has_no_lamp() {
        // A wall behind the air, 3 m away.
        let corner = |x: f32, y: f32| Vec3::new(x, y, 3.0);
        let mesh = Mesh {
            positions: vec![corner(-9.0, -9.0), corner(9.0, -9.0), corner(0.0, 9.0)],
            normals: vec![Vec3::NEG_Z; 3],
            triangles: vec![[0, 1, 2]],
        };
        let scene = RayScene::new(&mesh);
        let air = |images: &[Option<KeyframeImage>]| LamplessAir::new(images, &[Pose::IDENTITY; 3], 250);
        let both = air(&[picture(300), None, picture(300)]);
        let told = |places: [Vec3; 5]| places.map(|p| both.has_no_lamp(&scene, p));
        let [front, behind, back, beside, bright] = told(
            [[0.0, 0.0, 2.0], [0.0, 0.0, 3.5], [0.0, 0.0, -2.0], [5.0, 0.0, 2.0], [1.1, 0.0, 2.0]].map(Vec3::from),
        );
        assert!(front && !behind && !back && !beside && !bright);
        assert!(!air(&[picture(300), None, None]).has_no_lamp(&scene, Vec3::new(0.0, 0.0, 2.0)), "one keyframe alone");
        assert!(!air(&[picture(0), None, picture(0)]).has_no_lamp(&scene, Vec3::new(0.0, 0.0, 2.0)), "all is bright");
    }
}
